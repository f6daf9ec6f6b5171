"""Provides names that a certificate shows in the language of the certificate: names of conditions, of estimators, and of references
that are named after their role.

In English, an estimator has the name that plans use. An estimator of a plug-in package has this name in every language.
"""

from __future__ import annotations

from planrunner.base.said import Said, said

_ROOM = {
    "temperature": said("Ambient temperature"),
    "pressure": said("Ambient pressure"),
    "humidity": said("Ambient humidity"),
}
CHAMBER_TEMPERATURE = said("Chamber temperature")
_ROLES = {"site": said("site"), "table": said("table"), "chamber": said("chamber")}
_ESTIMATORS = (
    said("flexure_gyro_static"),
    said("compensation_residual"),
    said("scale_factor"),
    said("scale_factor_tilted"),
    said("fixture_angles"),
    said("rocking_drift"),
    said("allan_deviation"),
    said("strapdown_navigation"),
    said("modulation_residual"),
    said("accelerometer_multi_position"),
    said("imu_multi_position"),
    said("temperature_model"),
    said("repeatability"),
    said("error_model"),
)
_BY_NAME = {str(name): name for name in _ESTIMATORS}


def of_room(condition: str) -> Said:
    """Returns the translated name of a condition of the room, such as `pressure`. A laboratory can state other conditions, which
    are not translated."""
    return _ROOM.get(condition) or said("Ambient {condition}", condition=condition.replace("_", " "))


def of_reference(name: str, role: str) -> Said:
    """Returns the name that the bench file gives the site or an instrument. The name is translated if it is only the role, such as
    `table`."""
    return _ROLES[role] if name == role and role in _ROLES else Said(name)


def of_estimator(name: str) -> Said:
    return _BY_NAME.get(name, Said(name))
