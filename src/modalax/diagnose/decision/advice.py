"""What to measure to tell rival causes apart."""

from collections.abc import Sequence

from modalax.diagnose.decision.posterior import Ranked

JOINTS = {"coulomb_friction", "elasto_slip", "cubic_stiffness", "gap", "quadratic_damping", "bilinear_stiffness"}
BY_SLUG = {
    "modal_damping": "check the settings of window and record length, or repeat without a window",
    "structural_damping": "calibrate the delay between the channels, and widen the band",
    "exponential_window": "repeat without the window, or with a longer record",
    "leakage": "repeat with a record twice as long",
    "fast_sweep": "sweep in both directions, or at half the rate",
    "time_delay": "calibrate the channels against each other on one sensor position",
    "channel_gain": "exchange the two sensors, or calibrate them",
    "sensor_mass": "repeat with a dummy mass at the sensor, or with the sensors all left in place",
    "added_mass": "repeat with a known mass added at the same place",
    "tuned_mass": "zoom into the split peak with a finer line spacing",
    "missing_mode": "measure a second column of the FRF matrix",
    "out_of_band": "measure a wider band",
    "mains_hum": "record a run without force",
    "force_dropout": "estimate the FRF as Hv, or from the generator's signal as reference",
    "time_varying": "repeat the first run at the end",
    "gyroscopic": "measure the FRF with force and response exchanged, at three inputs or more",
    "units": "check the unit of one channel against a known motion",
    "channel_sign": "turn one sensor and repeat",
    "channel_swap": "tap at each sensor and look which channel answers",
}


def advise(verdict: str, sets: Sequence[Ranked]) -> str:
    """One sentence on what would widen the angle between the candidates."""
    if verdict == "unknown":
        return (
            "something remains that no known cause explains: look at the residual map for where it lives, "
            "repeat at another force level and with another input"
        )
    slugs = {slug for r in sets for slug, _ in r.names}
    places = {where for r in sets for _, where in r.names}
    parts = []
    if slugs & JOINTS and len(slugs) > 1:
        parts.append(
            "measure at three force levels or more, spread over a factor of ten, and look at the third harmonic"
        )
        if "bilinear_stiffness" in slugs:
            parts.append("record the mean displacement and the even harmonics")
    if len(places) > 1:
        names = sorted({str(n) for where in places for n in where})
        parts.append(f"add a sensor or an input at {', '.join(names[:6])}")
    parts += [BY_SLUG[slug] for slug in sorted(slugs - JOINTS) if slug in BY_SLUG][: 3 - len(parts[:2])]
    return "; ".join(dict.fromkeys(parts)) or "measure another column of the FRF matrix"
