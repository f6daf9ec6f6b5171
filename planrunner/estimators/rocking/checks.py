"""Checks a rocking test before it runs: windows, timing, pattern of runs, caging and resolution. Also checks whether the drift
about each axis can be measured.

A finding is an error if the drift under rocking could not be computed, or would be wrong. A finding is a warning if the result
would be valid, but less accurate than the method permits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise

from planrunner.estimators.interface import DesignRequest, EstimationError, Remark
from planrunner.estimators.rocking.parameters import RockingDriftParameters
from planrunner.estimators.rocking.runs import Quadruple, Run, by_state, quadruples
from planrunner.estimators.rocking.solution import lead_of
from planrunner.estimators.rocking.windows import SAMPLES, passed
from planrunner.plan.schedule import Rock
from planrunner.plan.units import STANDARD_GRAVITY, unit

LEAST_RELEASE = 60.0  # s
LEAST_WINDOW = 2.0  # s
LONGEST_ROCKING = 480.0  # s
LARGEST_PHASE = math.radians(45)
PASSED = 0.01  # largest fraction of the rocking acceleration that may pass the filter
ARCSEC = math.radians(1 / 3600)
SMALL = 1e-6


def span(runs: Sequence[Run]) -> float | None:
    """Returns the planned dwell [s] of the shortest run; None if the dwell of a run is `recorded`."""
    dwells = [run.segment.dwell for run in runs if run.segment.dwell is not None]
    return min(dwells) if len(dwells) == len(runs) else None


def remarks(request: DesignRequest[RockingDriftParameters], runs: Sequence[Run]) -> list[Remark]:
    parameters = request.parameters
    found = [*_windows(parameters), *_encoders(request), *_sampling(request, runs), *_caging(runs)]
    found += _rocking(runs, parameters)
    try:
        groups = by_state(quadruples(runs))
    except EstimationError as error:
        if any(run.caged_before is False for run in runs):
            return found  # a run without caging before it may have been meant as the caged run
        hint = "plan static-1, dynamic-1, dynamic-2, static-2 in each orientation"
        return [*found, Remark("physics-rocking-pattern", str(error), hint, error=True)]
    found += _timing(runs)
    found += _unseen(groups)
    found += _release_time(request, runs)
    dwell = span(runs)
    if dwell is not None:
        found += _dwell(runs, dwell, parameters)
        found += _resolution(request, dwell, parameters)
    return found


def _windows(parameters: RockingDriftParameters) -> list[Remark]:
    found = []
    release, window = parameters.release.value, parameters.window.value
    if release < LEAST_RELEASE - SMALL:
        message = (
            f"{release:g} s after release, the element may still be in the dead zone of the levelling loops (1 arcmin at 1 deg/h lasts "
            "60 s)"
        )
        found.append(Remark("physics-rocking-release", message, "allow 60 s or more", "release"))
    if window < LEAST_WINDOW - SMALL:
        message = f"a window of {window:g} s is shorter than the 2 s that the method requires"
        found.append(Remark("physics-rocking-window", message, "average over 2 s or more", "window"))
    return found


def _release_time(request: DesignRequest[RockingDriftParameters], runs: Sequence[Run]) -> list[Remark]:
    """Checks that the time since the release of the element is known. With `azimuth: nominal`, this time is needed, because the
    Earth turns relative to the element after the release."""
    parameters = request.parameters
    if parameters.azimuth != "nominal":
        return []
    try:
        lead_of(runs[0], parameters, request.setup)
    except EstimationError as error:
        hint = "`released_before: 0 s` where each record begins with the release"
        return [Remark("physics-rocking-released", str(error), hint, "azimuth", error=True)]
    return []


def _encoders(request: DesignRequest[RockingDriftParameters]) -> list[Remark]:
    """Reports missing encoders, and names of gimbal axes that are certainly wrong. For a bench without a table, encoders are not
    checked, because such a bench may play back a recording with more channels than the bench file names."""
    parameters = request.parameters
    found = []
    if any(outer == inner for outer, inner in pairwise(parameters.gimbal_axes)):
        message = f"two adjacent gimbals turn about the same axis ({', '.join(parameters.gimbal_axes)}): they cannot stabilise the element"
        hint = "name the three axes, outermost first, such as [x, y, z]"
        found.append(Remark("physics-rocking-encoders", message, hint, "gimbal_axes", error=True))
    table = request.setup.table
    if table is None or parameters.azimuth != "encoders":
        return found
    hint = "correct the names, or write `azimuth: nominal`"
    missing = [name for name in (*parameters.rings, *parameters.gimbals) if request.sensor.output(name) is None]
    if missing:
        key = "rings" if missing[0] in parameters.rings else "gimbals"
        message = f"the azimuth comes from encoders, but the sensor has no output '{missing[0]}'"
        found.append(Remark("physics-rocking-encoders", message, hint, key, error=True))
    if len(table.axes) != len(parameters.rings):
        message = f"`rings` names {len(parameters.rings)} channels, but the table has {len(table.axes)} axes"
        found.append(Remark("physics-rocking-encoders", message, hint, "rings", error=True))
    return found


def _sampling(request: DesignRequest[RockingDriftParameters], runs: Sequence[Run]) -> list[Remark]:
    cutoff = request.parameters.cutoff.value
    rate = min(run.segment.sample_rate or request.sensor.sample_rate for run in runs)
    if cutoff <= rate / SAMPLES:
        return []
    message = f"a cutoff of {cutoff:g} Hz needs {SAMPLES * cutoff:g} samples per second, but the plan has {rate:g}"
    return [Remark("physics-rocking-filter", message, "lower `cutoff`, or sample faster", "cutoff", error=True)]


def _caging(runs: Sequence[Run]) -> list[Remark]:
    free = [run.label for run in runs if run.caged_before is False]
    if free:
        message = (
            f"the platform is not caged before '{free[0]}'{_more(free)}: its element continues from its state at "
            "the end of the preceding run"
        )
        return [
            Remark("physics-rocking-caging", message, "put a segment with `mode: caged` before each run", error=True)
        ]
    unknown = [run.label for run in runs if run.caged_before is None]
    if unknown:
        message = f"whether the platform is caged before '{unknown[0]}'{_more(unknown)} cannot be determined from the selected segments"
        return [Remark("physics-rocking-caging", message, 'choose the caged segments too, such as `segments: "*"`')]
    return []


def _rocking(runs: Sequence[Run], parameters: RockingDriftParameters) -> list[Remark]:
    found: list[Remark] = []
    for run in runs:
        motion = run.segment.motion
        if not isinstance(motion, Rock) or any(motion == other.segment.motion for other in runs[: runs.index(run)]):
            continue
        if motion.duration > LONGEST_ROCKING + SMALL and math.isfinite(motion.duration):
            message = f"'{run.label}' rocks for {motion.duration / 60:g} min; the method allows at most 8 min"
            found.append(Remark("physics-rocking-duration", message, "add `for: 8 min`"))
        found += _phases(run, motion)
        cutoff = parameters.cutoff.value
        if passed(motion.frequency, cutoff) > PASSED:
            message = f"the filter passes {100 * passed(motion.frequency, cutoff):.0f} % of the rocking at {motion.frequency:g} Hz"
            found.append(
                Remark("physics-rocking-filter", message, f"lower `cutoff` to {motion.frequency / 4:g} Hz", "cutoff")
            )
    return found


def _phases(run: Run, motion: Rock) -> list[Remark]:
    differences = [later - before for before, later in zip(motion.phases, motion.phases[1:], strict=False)]
    hint = "write for example phases: [0 deg, 45 deg, 90 deg]"
    shown = ", ".join(f"{math.degrees(phase):g}" for phase in motion.phases)
    if differences and max(differences) - min(differences) > SMALL:
        message = f"the phases of the rings of '{run.label}' ({shown} deg) are not equally spaced"
        return [Remark("physics-rocking-phases", message, hint)]
    if any(abs(difference) > LARGEST_PHASE + SMALL for difference in differences):
        message = f"the phases of the rings of '{run.label}' ({shown} deg) have steps of more than 45 deg"
        return [Remark("physics-rocking-phases", message, hint)]
    return []


def _timing(runs: Sequence[Run]) -> list[Remark]:
    first = runs[0]
    for run in runs[1:]:
        if run.segment.dwell != first.segment.dwell or run.segment.settle != first.segment.settle:
            message = (
                f"'{run.label}' has a different timing from '{first.label}', so errors common to all runs do not cancel"
            )
            return [Remark("physics-rocking-timing", message, "give all runs the same dwell and settle", error=True)]
    motions = [run for run in runs if run.dynamic]
    other = [run for run in motions if run.segment.motion != motions[0].segment.motion]
    if other:
        message = f"'{other[0].label}' rocks differently from '{motions[0].label}', so their drifts cannot be compared"
        return [Remark("physics-rocking-timing", message, "use the same rocking in all dynamic runs", error=True)]
    return []


def _dwell(runs: Sequence[Run], dwell: float, parameters: RockingDriftParameters) -> list[Remark]:
    second = parameters.second(dwell)
    if second + parameters.window.value > dwell + SMALL:
        message = f"the second window ends at {second + parameters.window.value:g} s, after the record of {dwell:g} s"
        return [
            Remark(
                "physics-rocking-dwell",
                message,
                "dwell longer, or make the second window begin earlier",
                "second_window",
                error=True,
            )
        ]
    if parameters.release.value + parameters.window.value > second:
        message = f"the second window, from {second:g} s on, does not follow the first, which ends at {_first_end(parameters):g} s"
        return [
            Remark("physics-rocking-dwell", message, "dwell 10 min, or 15 min for a smaller method error", error=True)
        ]
    cutoff, between = parameters.cutoff.value, second - _first_end(parameters)
    if 1 / cutoff > between:
        message = (
            f"a filter with a cutoff of {cutoff:g} Hz averages over {1 / cutoff:.3g} s, but the windows are "
            f"only {between:g} s apart: the filter would mix them"
        )
        hint = f"raise `cutoff` to {1 / between:.2g} Hz or more" if between > 0 else "dwell longer"
        return [Remark("physics-rocking-filter", message, hint, "cutoff", error=True)]
    late = [run for run in runs if run.rocking_ends > second]
    if late:
        ends = late[0].rocking_ends
        when = "as long as it records" if not math.isfinite(ends) or ends > dwell else f"until {ends:g} s"
        message = f"'{late[0].label}' still rocks when its second window begins at {second:g} s: it rocks {when}, including the fade-out"
        return [Remark("physics-rocking-end", message, "shorten `for`, or dwell longer", error=True)]
    return []


def _first_end(parameters: RockingDriftParameters) -> float:
    return parameters.release.value + parameters.window.value


def count_seconds(
    request: DesignRequest[RockingDriftParameters], parameters: RockingDriftParameters
) -> tuple[str, float, float] | None:
    """Finds the accelerometer with the largest count. Returns its name, the size of the count [m/s^2], and the time [s] in which
    the smallest drift of interest changes its reading by one count. Returns None if no accelerometer has a stated count. Raises
    `EstimationError` if the sensor lacks an accelerometer."""
    coarsest: tuple[str, float, float] | None = None
    for name in parameters.accelerometers:
        output = request.sensor.output(name)
        if output is None:
            raise EstimationError(
                f"the bench's sensor has no output '{name}': name its accelerometers in `accelerometers`"
            )
        count = output.noise.resolution * unit(output.unit).factor
        if count and (coarsest is None or count > coarsest[1]):
            coarsest = name, count, count / request.site.gravity / parameters.smallest_drift.value
    return coarsest


def count_in_words(count: float, seconds: float, parameters: RockingDriftParameters, gravity: float) -> str:
    """States in words the size of one count in arc seconds and in g, and the time in which the smallest drift changes the reading
    by one count."""
    size = f"{count / STANDARD_GRAVITY * 1e6:.3g} µg, {count / gravity / ARCSEC:.3g} arcsec"
    return f"at {parameters.smallest_drift}, a change of one count ({size}) takes {seconds:.3g} s"


def _resolution(
    request: DesignRequest[RockingDriftParameters], dwell: float, parameters: RockingDriftParameters
) -> list[Remark]:
    found = count_seconds(request, parameters)
    between = parameters.second(dwell) - parameters.release.value
    if found is None or found[2] <= between or between <= 0:
        return []
    name, count, seconds = found
    output = request.sensor.output(name)
    full_scale = output.full_scale * unit(output.unit).factor / STANDARD_GRAVITY if output else math.inf
    told = f"{name}, {full_scale:.3g} g range" if math.isfinite(full_scale) else name
    words = count_in_words(count, seconds, parameters, request.site.gravity)
    message = f"{told}: {words}, but the time between the windows is {between:g} s"
    hint = (
        "use the accelerometers' 1.25 g range"
        if full_scale > 2
        else "dwell longer, or set `smallest_drift` to the drift that you need to resolve"
    )
    return [Remark("physics-rocking-resolution", message, hint, "smallest_drift")]


def _unseen(groups: Sequence[Sequence[Quadruple]]) -> list[Remark]:
    seen = {axis for group in groups for axis in group[0].runs[0].state.level}
    missing = ["xyz"[axis] for axis in range(3) if axis not in seen]
    if not missing:
        return []
    axis = missing[0]
    message = f"{axis} is vertical in every state, so gravity does not show a drift about this axis: drift_{axis} cannot be determined"
    return [
        Remark("physics-rocking-axes", message, f"add a state in which {axis} is level, with the base turned by 90 deg")
    ]


def _more(labels: Sequence[str]) -> str:
    return f" and {len(labels) - 1} more" if len(labels) > 1 else ""
