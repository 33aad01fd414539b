"""The one system of units: micrometre, microsecond, nanogram.

=====================  ==============  =========================
quantity               unit            in SI
=====================  ==============  =========================
length                 µm              1e-6 m
time                   µs              1e-6 s
mass                   ng              1e-12 kg
velocity               µm/µs           1 m/s
acceleration           µm/µs²          1e6 m/s²
force                  µN              1e-6 N
stiffness              µN/µm           1 N/m
2D stress              µN/µm           1 N/m
2D mass density        ng/µm²          1 kg/m²
energy                 µN·µm = pJ      1e-12 J
2D dynamic viscosity   ng/µs           1e-6 kg/s
deformation gradient   1               1
rate of deformation    1/µs            1e6 1/s
=====================  ==============  =========================

A 2D stress divided by the tissue thickness in µm is a 3D stress in MPa (µN/µm² = MPa).
"""

from __future__ import annotations

import math

LENGTH = "µm"
TIME = "µs"
MASS = "ng"
VELOCITY = "µm/µs"
ACCELERATION = "µm/µs²"
FORCE = "µN"
STIFFNESS = "µN/µm"
STRESS = "µN/µm"
ENERGY = "pJ"
RATE = "1/µs"
VISCOSITY = "µN µs/µm"  # the same as ng/µs
NONE = "1"


def with_micro_sign(text: str) -> str:
    """Return a text in which Greek mu (U+03BC) is the micro sign (U+00B5), which looks the same.

    Keyboards and editors give either; names and units are compared after this.
    """
    return text.replace("\u03bc", "\u00b5")


def time_text(seconds: float) -> str:
    """Write seconds as people read them: "12.3 s", "3 min 20 s"."""
    if seconds < 60.0:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest} s"


def rough_time(seconds: float) -> str:
    """Write an order of magnitude of seconds, in one digit and the unit that suits it."""
    unit = "s"
    size = 1.0
    for larger, seconds_of_it in (("min", 60.0), ("h", 3600.0), ("days", 86400.0)):
        if seconds >= 1.5 * seconds_of_it:
            unit = larger
            size = seconds_of_it
    return f"{float(f'{seconds / size:.1g}'):g} {unit}"


def rough_number(value: float, digits: int = 1) -> str:
    """Write an order of magnitude: so many digits, then zeros."""
    return f"{float(f'{value:.{digits}g}'):,.0f}"


def number(value: float, digits: int = 3) -> str:
    """Write a number of so many significant digits, without an exponent."""
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g}"
    decimals = digits - 1 - math.floor(math.log10(abs(value)))
    thousands = "," if abs(value) >= 1e4 else ""
    text = f"{value:{thousands}.{max(0, decimals)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
