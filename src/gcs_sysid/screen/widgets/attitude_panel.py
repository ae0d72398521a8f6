"""The attitude panel: an artificial horizon in text, angles, body rates, rotor speeds."""

import math

from gcs_sysid.model.parameters import AXES
from gcs_sysid.screen import formatting as fmt
from gcs_sysid.screen.view import View
from gcs_sysid.screen.widgets.lines import Line, Lines

HORIZON_WIDTH = 25
WINGS = "━━━┫◆┣━━━"
_GROUND, _SKY = "#8a5a2b", "#2d6a9f"


def horizon(roll: float, pitch: float, height: int) -> list[str]:
    """An artificial horizon: the ground in half blocks, the sky blank, the wings in the middle.

    Args:
        roll: rad, right wing down positive; the ground then rises on the right.
        pitch: rad, nose up positive; the ground then sinks.
        height: lines of the drawing, an odd number.
    """
    rows = 2 * height
    sink = math.degrees(pitch) * rows / 60.0  # 60° from the top to the bottom
    sine, cosine = math.sin(roll), math.cos(roll)

    def ground(column: int, row: int) -> bool:
        # Half a cell is about as high as a cell is wide, so that angles look right.
        x = column - (HORIZON_WIDTH - 1) / 2
        y = row - (rows - 1) / 2 - sink
        return y * cosine + x * sine > 0.0

    blocks = {(False, False): " ", (True, True): "█", (True, False): "▀", (False, True): "▄"}
    lines = [
        [
            blocks[ground(column, 2 * line), ground(column, 2 * line + 1)]
            for column in range(HORIZON_WIDTH)
        ]
        for line in range(height)
    ]
    middle, start = height // 2, (HORIZON_WIDTH - len(WINGS)) // 2
    lines[middle][start : start + len(WINGS)] = WINGS
    return ["".join(line) for line in lines]


def deflection(value: float, limit: float, width: int) -> str:
    """A bar from the middle outwards: left for negative values, right for positive ones."""
    half = width // 2
    cells = min(half, round(abs(value) / limit * half))
    left = "━" * cells if value < 0 else ""
    right = "━" * cells if value > 0 else ""
    return f"{left:>{half}}│{right:<{half}}"


class AttitudePanel(Lines):
    """Attitude of the vehicle and its rotor signals."""

    BORDER_TITLE = "Attitude and rotors"

    def __init__(self) -> None:
        super().__init__(id="attitude")
        self._top_speed = 1.0

    def show(self, view: View) -> None:
        """Bring the panel up to date."""
        self.put(self._horizon_lines(view) + self._angle_lines(view) + self._rotor_lines(view))

    def _horizon_lines(self, view: View) -> list[Line]:
        if view.snapshot is None or view.snapshot.attitude is None:
            return [[("no attitude yet", fmt.MUTED)]]
        roll, pitch, _ = view.snapshot.attitude
        rows = self.screen.size.height
        drawing = horizon(roll, pitch, 7 if rows >= 48 else 3 if 32 <= rows < 44 else 5)
        colors = f"{_GROUND} on {_SKY}"
        lines = []
        for line in drawing:
            left, wings, right = line.partition(WINGS)
            lines.append(
                [("  ", ""), (left, colors), (wings, f"bold #ffffff on {_SKY}"), (right, colors)]
            )
        return lines

    def _angle_lines(self, view: View) -> list[Line]:
        if view.snapshot is None or view.snapshot.attitude is None:
            return []
        lines = []
        rates = view.snapshot.rates
        limits = (45.0, 45.0, 180.0)
        for index, name in enumerate(AXES):
            angle = math.degrees(view.snapshot.attitude[index])
            # Rounded before the sign is written, so that there is no "-0.0".
            angle = round(angle, 1) + 0.0
            rate = "" if rates is None else f"{round(math.degrees(rates[index])) + 0:+5d} °/s"
            lines.append(
                [
                    (f"{name:<6}", fmt.MUTED),
                    (f"{angle:+6.1f}°", "bold"),
                    (f" {deflection(angle, limits[index], 10)} ", "$text-primary"),
                    (rate, ""),
                ]
            )
        return lines

    def _rotor_lines(self, view: View) -> list[Line]:
        if view.snapshot is None or not view.snapshot.rotor_speeds:
            return [[("no rotor speeds", fmt.MUTED)]]
        speeds = view.snapshot.rotor_speeds
        if view.snapshot.result.rotor_input.motors:
            return [
                [
                    (f"rotor {number:<2}", fmt.MUTED),
                    (f"{100.0 * command:5.1f}", "bold"),
                    (" %     ", ""),
                    (fmt.bar(command, 14), "$text-primary on $panel"),
                ]
                for number, command in enumerate(speeds, start=1)
            ]
        # The scale only grows, in steps, so that the bars compare from one moment to the next.
        self._top_speed = max(self._top_speed, 100.0 * math.ceil(max(speeds) * 1.1 / 100.0))
        lines = []
        for number, speed in enumerate(speeds, start=1):
            lines.append(
                [
                    (f"rotor {number:<2}", fmt.MUTED),
                    (f"{speed:5.0f}", "bold"),
                    (" rad/s ", ""),
                    (fmt.bar(speed / self._top_speed, 14), "$text-primary on $panel"),
                ]
            )
        return lines
