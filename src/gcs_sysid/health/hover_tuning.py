"""The thresholds for judging hover, in one place, with their evidence."""

from dataclasses import dataclass


@dataclass(frozen=True)
class HoverTuning:
    """Of the averages over hover and of what is concluded from them.

    Attributes:
        most_samples: of the IMU that are kept of a log, over an hour at 250 Hz: judging them
            takes 1 kB of memory each, and more hours of hover say no more.
        half_window: s, half the width of the triangular weights. Motor lags (50 ms) are short
            against it, gusts and battery are long.
        samples_a_half: of the slowest stream in half a window, at least.
        longest_gap: in halves of a window, that a stream may have within one.
        fewest_samples: of a stream.
        slowest_rotors: Hz, of speeds or commands.
        enough_rate: Hz; beyond it a faster rotor stream brings nothing to averages.
        longest_lag: s, of motors and transport that is looked for.
        lag_step: s between the lags tried.
        order_windows: s, half widths of windows in which motion shows where the rotors are: short
            against gusts, and those that a motor's lag leaves something of.
        order_delays: s by which thrust may lag behind commands: a lag, seen over tenths of a
            second, is a delay.
        fewest_for_order: such windows.
        least_explained: share of roll and pitch acceleration that a layout must explain to be
            taken. Right ones explained 0.48 to 0.99 of given logs,
            wrong orders at most a tenth of that, a frame turned by 45 degrees half.
        more_explained: times what any other layout explains.
        crosstalk: of the angular acceleration in roll or pitch, what the other may get of it.
        surely_explained: share from which on an airframe's rotors surely turn the vehicle.
        carrying: of the most that the rotors do, from which they may carry the vehicle.
        most_rate: rad/s, in hover.
        most_turning: rad/s^2, mean over a window.
        most_lift: relative deviation of thrust over mass from gravity.
        most_speed: m/s over the ground: rotor drag and inflow grow with it.
        fewest_windows: of hover, for an answer.
        curve_std: standard deviation of the thrust curve c where nothing else is known.
        range_std: standard deviation of the command without thrust over an assumed range: pulses
            begin to turn motors at 1000 to 1200 us.
        least_throttle_motion: standard deviation of the mean command, from which the curve is
            estimated.
        lift_std: relative, of gravity's balance: attitude, own acceleration.
        climb_drag: 1/s, prior standard deviation of thrust over mass that 1 m/s of climb costs:
            body drag makes 0.1 to 0.3, inflow into lightly loaded rotors more.
        accelerometer_std: m/s^2, bias of an accelerometer where no attitude is logged.
        unseen_climb: m/s, vertical speed where none is logged.
        turning_share: of a rotor's load, change for 1 rad/s^2 of turning: prior deviation.
        rotor_repeats: of a rotor's load from flight to flight, nothing having changed.
        common_speed: of all loads together by speeds: air density, battery mass.
        common_command: the same by commands: the battery's charge besides.
        yaw_repeats: of the yaw balance.
        cg_repeats: m over meter of arm, of the CG from flight to flight, nothing having moved.
        cg_stays: the same where nothing was moved or loaded: the apparent shift by wind.
        calm: m/s^2, by how much the specific force in the rotors' plane varies without wind.
        moved_by_gusts: of the sum, the yaw balance and (in arms) the center of thrust, for a
            variation of that force by 1 m/s^2 beyond `calm`. Gusts slower than a stretch of hover
            do not show in its own scatter: in gusts of 0.3 to 1.2 m/s the means of ten seconds
            were off by 2 to 4 times that (`benchmarks.health_alarms`, other seeds).
        parameter_penalty: chi-square for each number that an explanation may choose.
        cg_fixed: chi-square for a CG that moves where nothing was moved. A CG explains the moments
            of any weak rotor, so it must exceed `named_margin`: at 9 a rotor of six or eight, whose
            yaw and sum gusts hide, was never named (`benchmarks.health --weak`).
        same_vehicle: factor of all loads within which two flights may be of one vehicle: payload,
            other propellers.
        learned_from: s of hover at the start of a flight that later ones in it are compared with.
        judged_by: s of hover in a stretch that is.
        least_change: of a rotor's load over another's in a stretch, relative, that is looked into:
            5 % less of one rotor of eight makes 2.5 %.
        named_margin: chi-square by which a weak rotor must beat all other explanations. Of 100
            flights with one and 300 stretches without, 8 misnamed none either; chosen on the
            flights of `benchmarks.health --weak 100` themselves.
        rival_margin: by which it must beat another rotor.
        least_loss: of its thrust that a weak rotor must have lost to be named. Of a hundred flights
            with 5 % none came out below 3.6 %; what was named without a fault had lost 2.4 % at
            most, by gusts (`benchmarks.health --first 100`, `benchmarks.health_alarms`).
        windier: times the noise power of both stretches together, from which on one keeps its own.
        shortest_drift: s of flight from which a drift is reported.
        full_command: command from which a rotor counts as saturated.
        usable_curve: standard deviation of c from which on it is no suggestion, and half of an
            interval that is of use: 0.15 changes the slope at hover by 6 % at 0.7 of full command.
        worth_knowing: over the arm, half of an interval of use of a place; relative, half of that
            of a hover's throttle or a drag.
        drag_rounds: of Gauss-Newton by half steps, for drag and wind.
        parts_of_flight: that a jackknife leaves out, one after the other.
        worth_drag: 1/s, half of an interval of use of momentum drag: wind of 3 m/s off by
            0.1 m/s^2.
        air_pressure: Pa, that there may be.
        pressure_spans: s of second differences of pressure: those of the answer, and shorter ones
            that they are compared with.
        unknown_pressure: prior standard deviations of the air's density, relative, and of s that
            the barometer is late, or climbs make it.
        pressure_floor: Pa at full thrust, that no flight goes below.
        worth_height: m between no thrust and a hover's, half of an interval of use.
        sea_level: kg/m^3, density of the air there (standard atmosphere).
        unknown_drag: prior standard deviations of rho / (2 B) in 1/m (B of 30 kg/m^2 makes 0.02)
            and of the wind's north and east in m/s.
        unknown_air: relative standard deviation of the air's density over that at sea level, where
            the autopilot's log does not show what it takes for it: fields up to 2000 m.
        above_idle: of the range of outputs, MOT_SPIN_MIN above what turns all rotors (ArduPilot's
            manual).
        idle_std: of the range of outputs, by which an idle is known.
        worth_moving: m over meter of arm, CG offset that is worth a hand's move.
        motor_scatter: of motors' gains, relative, that is usual.
        sure: standard deviations beyond that.
        least_thrust_to_weight: usual advice of the autopilots' manuals is 2.
        much_saturated: share of the flight at full command.
        much_yaw: share of the load, of a yaw imbalance that is worth a look at the motors: rotors
            whose torque scatters by 3 % make 1.5 % on a quad, sound ones of given logs up to 3.5 %.
        shaking: times the others' vibration.
        least_shaking: m/s^2, amplitude below which it is no concern.
        phase_stretch: s over which vibration is correlated with a rotor's phase; a speed off by
            0.1 % turns the phase of 100 Hz by 0.3 rad meanwhile.
        floor_beside: Hz off the rotor's frequency, where the floor is taken.
        nyquist_share: of half of the IMU's rate, below which a rotor's frequency is seen.
        fewest_stretches: for an amplitude.
        stretches_at_once: worked on together.
        instrument_lags: windows before, of the commands that are instruments: beyond the windows'
            overlap and the memory of gusts (0.3 s).
        curve_floor: standard deviation of c that no flight goes below: motor lag, battery. Of
            ninety flights of `benchmarks.health` with speeds 94 % held; at 0.004, 86 %.
        gusts_beside: factor of c's standard deviation where the accelerometer alone shows the
            thrust: gusts that the autopilot answers leave some of their bias. Of eighty flights of
            `benchmarks.health` errors were 1.3 times what the fits said, with climbs of 1.5 m as of
            3 m.
        drag_lever: arms, prior standard deviation of the height that drag acts at.
        turbulence: standard deviation of a wind over its mean, near the ground.
        climb_share: of what a mean climb seems to cost, that may be real.
        instruments_std: standard deviation of c up to which the instruments are strong enough.
        gust_bias: relative error of the thrust's slope, over the share of gusts in its power
            (measured over nine flights of `benchmarks.health`).
        white_neighbors: autocorrelation of neighboring windows, of white noise and of gusts.
        fewest_blocks: of a length, whose scatter is taken.
        apart: s between flights of a day, to within a factor: its logarithm counts.
        cg_floor: arms, that no flight goes below.
    """

    most_samples: int = 1_000_000
    half_window: float = 0.5
    samples_a_half: float = 2.5
    longest_gap: float = 1.0
    fewest_samples: int = 8
    slowest_rotors: float = 2.0
    enough_rate: float = 50.0
    longest_lag: float = 0.4
    lag_step: float = 0.02
    order_windows: tuple[float, ...] = (0.05, 0.1, 0.2)
    order_delays: tuple[float, ...] = (0.0, 0.02, 0.04, 0.06, 0.08)
    fewest_for_order: int = 60
    least_explained: float = 0.1
    more_explained: float = 1.5
    crosstalk: float = 0.05
    surely_explained: float = 0.2
    carrying: float = 0.2
    most_rate: float = 0.5
    most_turning: float = 3.0
    most_lift: float = 0.15
    most_speed: float = 4.0
    fewest_windows: int = 6
    curve_std: float = 0.35
    range_std: float = 0.1
    least_throttle_motion: float = 0.003
    lift_std: float = 0.001
    climb_drag: float = 1.0
    accelerometer_std: float = 0.07
    unseen_climb: float = 0.5
    turning_share: float = 0.05
    rotor_repeats: float = 0.001
    common_speed: float = 0.002
    common_command: float = 0.05
    yaw_repeats: float = 0.001
    cg_repeats: float = 0.0015
    cg_stays: float = 0.0004
    calm: float = 0.09
    moved_by_gusts: float = 0.04
    parameter_penalty: float = 2.0
    cg_fixed: float = 30.0
    same_vehicle: float = 2.0
    learned_from: float = 30.0
    judged_by: float = 10.0
    least_change: float = 0.01
    named_margin: float = 10.0
    rival_margin: float = 6.0
    least_loss: float = 0.03
    windier: float = 3.0
    shortest_drift: float = 20.0
    full_command: float = 0.99
    usable_curve: float = 0.15
    worth_knowing: float = 0.1
    unknown_air: float = 0.1
    drag_rounds: int = 12
    parts_of_flight: int = 10
    air_pressure: tuple[float, float] = (1e4, 2e5)
    pressure_spans: tuple[float, float] = (2.0, 1.0)
    unknown_pressure: tuple[float, float] = (0.05, 0.3)
    pressure_floor: float = 2.0
    worth_height: float = 1.0
    worth_drag: float = 0.03
    sea_level: float = 1.225
    unknown_drag: tuple[float, float, float] = (0.02, 5.0, 5.0)
    above_idle: float = 0.03
    idle_std: float = 0.01
    worth_moving: float = 0.02
    motor_scatter: float = 0.03
    sure: float = 3.0
    least_thrust_to_weight: float = 1.7
    much_saturated: float = 0.005
    much_yaw: float = 0.05
    shaking: float = 3.0
    least_shaking: float = 1.0
    phase_stretch: float = 0.5
    floor_beside: tuple[float, ...] = (-12.0, -8.0, 8.0, 12.0)
    nyquist_share: float = 0.9
    fewest_stretches: int = 10
    stretches_at_once: int = 64
    instrument_lags: tuple[int, ...] = (2, 3, 4, 5, 6)
    curve_floor: float = 0.008
    gusts_beside: float = 1.3
    drag_lever: float = 1.0
    turbulence: float = 0.3
    climb_share: float = 0.5
    instruments_std: float = 0.05
    gust_bias: float = 0.8
    white_neighbors: tuple[float, float] = (0.25, 0.5)
    cg_floor: float = 0.0005
    fewest_blocks: int = 3
    apart: float = 3600.0


TUNING = HoverTuning()
