"""Names in the data that certificates translate: of conditions, references, decision rules and estimators.

A certificate looks up these names in the catalogue of its language; names without a translation stay in English. Sentences are
`planrunner.base.said.Said` in the code that makes them, where `make catalogues` finds them.
"""

from __future__ import annotations


def _(words: str) -> str:
    """Marks words for the catalogues."""
    return words


CONDITIONS = (
    _("Ambient temperature"),
    _("Ambient pressure"),
    _("Ambient humidity"),
    _("Chamber temperature"),
)
REFERENCES = (_("site"), _("table"), _("chamber"))
RULES = (_("simple"), _("guarded"))
ESTIMATORS = (
    _("flexure_gyro_static"),
    _("compensation_residual"),
    _("scale_factor"),
    _("scale_factor_tilted"),
    _("fixture_angles"),
    _("rocking_drift"),
    _("allan_deviation"),
    _("strapdown_navigation"),
    _("modulation_residual"),
    _("accelerometer_multi_position"),
    _("imu_multi_position"),
    _("temperature_model"),
    _("repeatability"),
    _("error_model"),
)
