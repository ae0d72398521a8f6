"""Blackbox logs as short as can be."""

from testbed import blackbox_log as bbl


def blackbox_of(folder, motors):
    """Fifty frames of a vehicle at rest."""
    arrays = {"gyroADC": 3, "accSmooth": 3, "motor": motors}
    names = [f"{name}[{i}]" for name, n in arrays.items() for i in range(n)]
    fields = [*bbl.CLOCK, *(bbl.Field(name, 1, 0, 0, bbl.PREVIOUS) for name in names)]
    settings = {
        "Firmware type": "Betaflight", "gyro_scale": bbl.float_bits(1.0), "acc_1G": 2048,
        "motorOutput": "48,2047",
    }  # fmt: skip
    writer = bbl.BlackboxWriter(fields, {}, settings, interval=16)
    for loop in range(50):
        row = [loop, 5_000_000 + 1000 * loop, 0, 0, 0, 0, 0, 2048, *(1000,) * motors]
        (writer.inter if loop % 16 else writer.intra)(row)
    path = folder / "log.bbl"
    path.write_bytes(writer.data + bbl.END)
    return path
