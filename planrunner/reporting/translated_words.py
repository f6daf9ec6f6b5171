"""Words of the shipped estimators and benches that certificates translate, for the catalogues.

A certificate looks up texts from the data (names of conditions and references, estimators, descriptions of coefficients, warnings) in the
catalogue of its language; texts without a translation stay in English. `make catalogues` finds the words here, because the code that makes
them is in English only. `%(name)s` marks a name or number inserted by that code; translations keep it.
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
DESCRIPTIONS = (
    # flexure_gyro_static, compensation_residual
    _("Torquer scale factor, %(axis)s"),
    _("Angle of the torquer's x axis to the case's x axis, ε"),
    _("Angle of the torquer's y axis to the case's y axis, ξ"),
    _("Drift D(%(drift)s), independent of acceleration; adds to ω_%(rate)s"),
    _("Drift D(%(drift)s), per acceleration along %(axis)s; adds to ω_%(rate)s"),
    _("Drift D(%(drift)s), per product of accelerations along %(first)s and %(second)s; adds to ω_%(rate)s"),
    _("Coefficient %(term)s of output i_%(axis)s"),
    _("Residual sum of squares of %(name)s"),
    _("Residual sum of squares of %(first)s over that of %(second)s"),
    # scale_factor
    _("%(output)s: offset at zero rate"),
    _("%(output)s: scale factor against the table's rate"),
    _("%(output)s: largest residual over the largest output"),
    _("%(output)s: difference of forward and backward scale factors"),
    # scale_factor_tilted, fixture_angles
    _("%(axis)s: scale factor along the axis"),
    _("%(axis)s: offset of the line at zero rate"),
    _("%(axis)s: difference of forward and backward scale factors over their mean"),
    _("%(axis)s: change of output between the lowest rates over the expected change"),
    _("%(axis)s: relative standard deviation of K between repeats"),
    _("%(axis)s: scale factor along the axis at %(temperature)sdegC"),
    _("%(axis)s: offset of the line at zero rate at %(temperature)sdegC"),
    _("%(axis)s: largest residual over the largest output at %(temperature)sdegC"),
    _("%(axis)s: difference of forward and backward scale factors over their mean at %(temperature)sdegC"),
    _("%(axis)s: change of output between the lowest rates over the expected change at %(temperature)sdegC"),
    _("%(axis)s: relative standard deviation of K between repeats at %(temperature)sdegC"),
    _("%(axis)s: slope of K over temperature, divided by K at the reference temperature"),
    _("%(axis)s: largest change of K from the reference temperature, divided by K and by the temperature difference"),
    _("%(axis)s: angle from the fixture's z axis"),
    _("%(axis)s: azimuth about the fixture's z axis, from x"),
    # strapdown_navigation, modulation_residual
    _("Azimuth of the unit's y axis after alignment, from true north towards east"),
    _("Elevation of the unit's y axis after alignment"),
    _("Rotation about the unit's y axis after alignment, positive with the x axis down"),
    _("East position error at the end"),
    _("North position error at the end"),
    _("East velocity error at the end"),
    _("North velocity error at the end"),
    _("Radial position error at the end"),
    _("Largest radial position error"),
    _("Root mean square of the radial position error over time"),
    _("Largest horizontal velocity error"),
    _("Root mean square of the horizontal velocity error over time"),
    _("Slope of the straight line through the origin fitted to radial error over time"),
    _("CEP rate of this run: √(ln 2) of the radial error rate"),
    _("CEP rate of %(first)s over that of %(second)s"),
    _("Rms radial error of %(first)s over that of %(second)s"),
    _("Amplitude of %(name)s's position error that repeats with its cycle"),
    # rocking_drift
    _("rocking drift about %(axis)s"),
    _("rocking drift about %(axis)s, from gimbal and ring angles"),
    # accelerometer_multi_position, imu_multi_position
    _("Bias of the %(axis)s axis"),
    _("Scale factor of the %(axis)s axis"),
    _("Scale factor of the %(axis)s axis, along its own input direction"),
    _("Component of the %(axis)s axis's input direction along %(across)s"),
    _("Component of the %(axis)s axis's input direction along %(across)s times its scale factor"),
    _("Non-orthogonality of the axes %(first)s and %(second)s: 90° minus the angle between them"),
    _("Bias of output %(axis)s"),
    _("Scale factor of output %(axis)s, along its own input axis"),
    _("Component of the input axis %(axis)s along %(across)s"),
    _("Response of output %(axis)s along %(across)s"),
    _("Response of output %(axis)s to specific force along %(along)s"),
    _("Rotation of the triad's own frame against the fixture's about %(axis)s"),
    _("Output %(output)s: Angular rate about the sensor's %(axis)s axis."),
    _("Output %(output)s: Product of the specific forces along %(first)s and %(second)s."),
    # error_model
    _("Parameter %(parameter)s of the effect %(effect)s in %(output)s"),
    _("Parameter %(parameter)s of the effect %(effect)s"),
    _("Scale factor of %(output)s along its own axis"),
    # allan_deviation
    _("quantisation: 3·Q²/τ²"),
    _("random walk of the integrated output: N²/τ"),
    _("bias instability: the flat part is at 0.664·B"),
    _("random walk of the output: K²·τ/3"),
    # temperature_model
    _("%(name)s at %(temperature)s degC"),
    _("%(name)s: coefficient of (T − %(temperature)s degC)^%(power)s"),
    _("%(name)s: largest difference between rising and falling temperature, at %(temperature)s degC"),
    # repeatability
    _("%(name)s: mean"),
    _("%(name)s: standard deviation from repeat to repeat"),
    _("%(name)s: standard deviation from repeat to repeat over mean"),
    _("%(name)s: standard deviation within groups"),
    _("%(name)s: standard deviation within groups over mean"),
    _("%(name)s: standard deviation between groups"),
    _("%(name)s: standard deviation within and between groups together (intermediate precision)"),
)
WARNINGS = (
    _(
        "%(output)s: residual variance is %(ratio)s times that expected from the noise within the segments and the "
        "declared inputs (probability by chance: %(chance)s). Something changes from segment to segment (positions or "
        "a slow drift), or the model is incomplete:"
        " the within-segment uncertainties are too small."
    ),
    _(
        "%(output)s: residual variance is %(ratio)s times that expected from the noise within the segments and the "
        "declared inputs (probability by chance: %(chance)s). Something changes from segment to segment (positions or a "
        "slow drift), or the model is incomplete: use the residual basis."
    ),
    _(
        "The residuals of %(first)s exceed its noise by more than the residuals of %(second)s exceed theirs (variance ratio %(ratio)s): "
        "write "
        "`pool_outputs: false` so that each output's uncertainty rests on its own residuals."
    ),
    _(
        "The residual variance is %(ratio)s times that expected from the noise within the poses (chance of that from "
        "noise alone:"
        " %(chance)s): the within-segment uncertainties are too small."
    ),
    _(
        "%(name)s: the fitted noise does not describe the deviations (χ² = %(chi)s with %(freedom)s degrees of "
        "freedom); "
        "uncertainties are widened %(factor)s-fold. Drift, vibration or a periodic disturbance may be in the record."
    ),
    _(
        "Segment '%(segment)s' does not fit the others: the mean of %(output)s lies %(error)s from the value expected "
        "from the others (%(deviations)s standard deviations; probability by chance: %(chance)s). Without it a "
        "coefficient changes by %(change)s standard uncertainties: check its label, its planned state and its data."
    ),
    _(
        "All three accelerometers respond with the opposite sign: either the recording contains gravity instead of "
        "specific force (which points up at rest), or the labels of opposite positions are exchanged."
    ),
    _(
        "All three gyros respond with the opposite sign: either the senses of the planned rotations are exchanged, or "
        "the sensor counts clockwise rates as positive."
    ),
    _(
        "%(output)s responds along %(axis)s with the opposite sign (scale factor %(factor)s): its axis is reversed. "
        "Check its sign in the bench file, its mounting and the labels of opposite positions."
    ),
    _(
        "%(output)s responds mostly along %(axis)s (%(response)s; along %(own)s %(factor)s): channels, axes or "
        "positions are exchanged. Check the channels in the bench file and the orientations of the segments."
    ),
    _("The three input axes form a left-handed triad: one axis is reversed, or two channels are exchanged."),
    _(
        "%(output)s has a scale factor of %(factor)s: its samples agree with %(other)s, but the recording declares "
        "%(unit)s. Correct its unit in the bench file."
    ),
    _(
        "%(output)s has a scale factor of %(factor)s, far from 1: check its unit and its sensitivity in the bench file,"
        " and the planned states."
    ),
    _(
        "%(name)s has the opposite sign to its nominal value in the bench file: the output is reversed, or the senses "
        "or labels of opposite states are exchanged."
    ),
    _(
        "%(name)s is %(ratio)s times its nominal value in the bench file: check the nominal value, the unit of the "
        "output and the planned states."
    ),
    _(
        "%(name)s: the noise coefficients describe averaging times from %(time)s s only. At shorter ones the deviations"
        " differ: the output is filtered or rounded, or contains a periodic disturbance such as vibration."
    ),
    _(
        "%(name)s: the noise coefficients describe averaging times up to %(time)s s only. At longer ones the deviations"
        " differ: the output warms up or drifts unsteadily."
    ),
    _(
        "%(name)s: the noise in '%(segment)s' is too small for counts of %(count)s, so rounding errors do not average "
        "out. They are the same whenever the sensor senses the same input: repeats do not reduce them, and scatter may "
        "not show them. The uncertainties may be too small, and noise coefficients are those of the rounding. Record "
        "with a finer resolution."
    ),
    _(
        "%(name)s: the drift by accelerometers is %(value)s, more than half the Earth rate. A reversed "
        "accelerometer causes such a drift: check the signs of the accelerometers and the orientation."
    ),
    _(
        "%(name)s: the drifts by gimbal angles and by accelerometers differ by %(value)s, more than their scatter "
        "and the position uncertainty of the table explain: check the signs of the accelerometers, gimbals and rings, "
        "and `gimbal_axes`."
    ),
    _(
        "%(name)s: the repeats scatter %(ratio)s times as much as their standard uncertainties allow (chance of that: "
        "%(chance)s). What changes from repeat to repeat is not in those uncertainties: use the standard deviation of "
        "the repeats."
    ),
    _(
        "%(name)s: values that follow each other are more alike than chance makes them (probability %(chance)s): the "
        "quantity drifts, or the repeats consist of groups, such as days or switch-ons. Name them in `groups`."
    ),
    _("Series %(series)s is cut short in '%(segment)s': it is left out."),
    _("Series %(series)s has %(count)s of %(most)s rates: it is left out."),
    _("Series %(series)s has other rates than the rest: it is left out."),
    _("Series %(series)s has no start zero: it is left out."),
    _("Series %(series)s has no end zero: it is left out."),
    _("Series %(series)s has no rates: it is left out."),
    _("Series %(series)s has no start zero and no end zero: it is left out."),
    _("Series %(series)s has no start zero and no rates: it is left out."),
    _("Series %(series)s has no end zero and no rates: it is left out."),
    _(
        "%(axis)s: at the lowest rate the output changes by %(share)s of the change expected from the scale factor. "
        "This is "
        "less than half, so the rate is within the threshold or dead zone (IEEE Std 528)."
    ),
    _(
        "During '%(segment)s' the velocity deviates from zero by %(factor)s times the amount that noise explains (vibration "
        "or a swaying base); the uncertainties of the alignment are widened by this factor."
    ),
    _("%(count)s missing samples were filled by linear interpolation; this may increase the navigation errors."),
    _("Without the gimbal-angle method: the recording has no channel '%(channel)s'."),
    _("Without the gimbal-angle method: the bench has no table with readable rings."),
    _("Without the gimbal-angle method: the table has %(axes)s axes, but `rings` names %(rings)s channels."),
    _("%(name)s: the highest order that was tried is chosen; raise `highest_order` or add temperatures."),
    _(
        "%(names)s: the outputs give different values (χ² = %(chi)s with %(freedom)s degrees of freedom), although they have this in "
        "common: something else acts on them, or the model of an output is incomplete."
    ),
    _(
        "%(name)s: rising and falling temperature were each recorded once, so that it is not known how much the hysteresis "
        "differs from cycle to cycle; the uncertainties do not include this. Record a second cycle."
    ),
    _(
        "%(name)s: the repeats are treated as one group, but differ between these groups: %(groups)s (variance ratio F = %(ratio)s, "
        "probability of a larger ratio by chance: %(chance)s). The uncertainty of their mean is too small. Name the groups in `groups`."
    ),
    _(
        "%(name)s: the scatter within the groups differs from group to group by more than chance (Bartlett's test): one standard "
        "deviation does not describe all groups. Look at the groups one by one."
    ),
    _(
        "Monte Carlo does not validate the stated interval of %(names)s: its ends differ by more than δ. The table "
        "gives both; "
        "use the Monte Carlo interval."
    ),
    _("Samples that are missing or not a number were left out: %(places)s. Check the recording."),
    _("Samples are missing; the longest gaps: %(places)s. Check the recording."),
)
