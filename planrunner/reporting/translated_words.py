"""Words of the shipped estimators and benches that certificates translate, for the catalogues.

A certificate looks up what it is given (names of conditions and references, descriptions of coefficients) in its language's catalogue and
shows as it stands what the catalogue lacks. `make catalogues` finds the words here, because the places that make them speak English only.
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
DESCRIPTIONS = (
    _("Torquer scale factor, x"),
    _("Torquer scale factor, y"),
    _("Angle of the torquer's x axis to the case's x axis, ε"),
    _("Angle of the torquer's y axis to the case's y axis, ξ"),
    _("Drift D(X), independent of acceleration; adds to ω_Y"),
    _("Drift D(X), per acceleration along x; adds to ω_Y"),
    _("Drift D(X), per acceleration along y; adds to ω_Y"),
    _("Drift D(X), per acceleration along z; adds to ω_Y"),
    _("Drift D(X), per product of accelerations along x and z; adds to ω_Y"),
    _("Drift D(X), per product of accelerations along y and z; adds to ω_Y"),
    _("Drift D(Y), independent of acceleration; adds to ω_X"),
    _("Drift D(Y), per acceleration along x; adds to ω_X"),
    _("Drift D(Y), per acceleration along y; adds to ω_X"),
    _("Drift D(Y), per acceleration along z; adds to ω_X"),
    _("Drift D(Y), per product of accelerations along x and z; adds to ω_X"),
    _("Drift D(Y), per product of accelerations along y and z; adds to ω_X"),
    _("offset at zero rate"),
    _("scale factor against the table's rate"),
    _("Bias of the x axis"),
    _("Scale factor of the x axis"),
    _("Scale factor of the x axis, along its own input direction"),
    _("Bias of the y axis"),
    _("Scale factor of the y axis"),
    _("Scale factor of the y axis, along its own input direction"),
    _("Bias of the z axis"),
    _("Scale factor of the z axis"),
    _("Scale factor of the z axis, along its own input direction"),
    _("Component of the x axis's input direction along y"),
    _("Component of the x axis's input direction along z"),
    _("Component of the y axis's input direction along x"),
    _("Component of the y axis's input direction along z"),
    _("Component of the z axis's input direction along x"),
    _("Component of the z axis's input direction along y"),
    _("Non-orthogonality of the axes x and y: 90° less their angle"),
    _("Non-orthogonality of the axes x and z: 90° less their angle"),
    _("Non-orthogonality of the axes y and z: 90° less their angle"),
    _("quantisation: 3·Q²/τ²"),
    _("random walk of the integrated output: N²/τ"),
    _("bias instability: the flat part lies at 0.664·B"),
    _("random walk of the output: K²·τ/3"),
)
