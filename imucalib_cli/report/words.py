"""How to read each figure of a report: the page and docs/report.md say it from this table."""

from __future__ import annotations

from typing import NamedTuple


class Words(NamedTuple):
    """What goes with a figure."""

    title: str
    shows: str
    """What is drawn; names in braces are filled in."""
    good: str
    """What it looks like where all is well."""
    faults: tuple[str, ...]
    """What it looks like where something is wrong, and what that is."""


_MOTION = Words(
    title="{quantity}: measured and predicted",
    shows=(
        "What the IMU measures, and what the robot's motion and the pose found predict, in the "
        "IMU's axes. Biases and errors of the sensor that were found are taken off. Both are seen "
        "through the same filter, {seconds} s long. The band is the range of the single samples. "
        "Grey stretches were left out of the fit."
    ),
    good="The two lines lie on each other, in fast motion too.",
    faults=(
        "Same shape, one earlier: the time offset is not constant, or is beyond the search.",
        "One axis mirrored or exchanged with another: the driver's axes, or the wrong link.",
        "Right at rest and wrong in motion: the wrong parent link, or a wrong URDF.",
        "The band far wider than the lines: vibration; look for a loose mount.",
    ),
)

WORDS: dict[str, Words] = {
    "accel": _MOTION,
    "gyro": _MOTION,
    "residuals": Words(
        title="Residuals: measured less predicted",
        shows="What the fit leaves in each window, in the IMU's axes.",
        good="Noise about zero, as wide in motion as at rest.",
        faults=(
            "Wider whenever the robot moves: robot or sensor are not as modelled.",
            "A step: the mount moved, or a bias stepped.",
            "A slow wave: the sensor warms up.",
            "Short peaks: shocks or contacts; the fit leaves them out.",
        ),
    ),
    "spectra": Words(
        title="Residuals against the sensor's noise",
        shows=(
            "Spectrum of the residuals, as noise density of the IMU's samples. The line is the "
            "sensor's own noise, from the difference of each sample from its neighbours. σ is "
            "computed from this spectrum."
        ),
        good="Flat, at the line or a little above it.",
        faults=(
            (
                "Flat but far above the line: the robot's encoders or its tracking are noisier "
                "than the IMU; σ includes it."
            ),
            "Rising to the left: a random walk of a bias, or errors of the robot's geometry.",
            "A peak: vibration, or a resonance of the mount.",
        ),
    ),
    "window": Words(
        title="The answer against the filter window",
        shows=(
            "The pose solved again with half and twice the window of {seconds} s, where the log "
            "allows it, minus the pose found. Bars are 1 σ of the difference."
        ),
        good="All within a few bars of zero: the answer does not depend on the filter.",
        faults=(
            (
                "Far from zero: something that no unknown of the model explains, such as a soft "
                "mount, play in the joints, or a wrong rate of the stamps."
            ),
        ),
    ),
    "segments": Words(
        title="Each part of the log on its own",
        shows=(
            "The pose by each of {count} parts of the log alone, less the pose by all of it. Bars "
            "are 1 σ of the part. Hollow marks at the edge lie beyond it."
        ),
        good="About two of three bars reach zero.",
        faults=(
            "A step from one part to the next: the mount moved, or was touched.",
            "A trend: temperature, a slipping mount or joint.",
            "Scatter far beyond the bars: errors of the robot that the model does not know.",
        ),
    ),
    "enough": Words(
        title="Did I record enough?",
        shows="1 σ of each component if the log ended there. Both axes are logarithmic.",
        good="σ falls all the way: ten times the duration for a third of σ.",
        faults=(
            (
                "A component that stays far above the others: the motion does not turn about the "
                "axes that would show it."
            ),
            "A late fall: the motion that determines it came late; begin with it next time.",
            "A flat end: more of the same motion does not help; move differently.",
        ),
    ),
    "taught": Words(
        title="Information of each stretch of the log",
        shows=(
            "Share of the log's information about each component of the pose, by stretches of "
            "equal length, along the parent link's axes and about them. The strongest colour of a "
            "row is its greatest share."
        ),
        good="Strong cells in every row, spread over the log.",
        faults=(
            "One strong cell in a row: the component rests on one movement; repeat it.",
            "Pale columns: the robot stood still, or moved about one axis only.",
        ),
    ),
    "offset": Words(
        title="The time offset",
        shows=(
            "How many σ worse the log fits with another time offset between IMU and robot, if all "
            "other unknowns are estimated again. The stripe is the estimate with 1 σ to either "
            "side: {found} ms."
        ),
        good="A sharp V with one tip.",
        faults=(
            "A wide or flat bottom: the motion has too few fast changes to time.",
            "Two tips, or a tip cut off: the stamps step within the log.",
        ),
    ),
    "stamps": Words(
        title="Health of the stamps",
        shows="Time from each sample's stamp to the next, as recorded.",
        good="A thin line.",
        faults=(
            "Peaks upwards: messages are lost.",
            (
                "Pairs of a peak and a dip: messages wait and then arrive together; stamp them at "
                "the source."
            ),
            "Below zero: stamps run backwards, or two publishers share the topic.",
        ),
    ),
    "parameters": Words(
        title="Errors of robot and sensor, before and after",
        shows=(
            "Every unknown of the model except the pose: 1 σ beforehand (the wide grey bar), and "
            "value and 1 σ afterwards (the coloured bar), on the scale of what was expected. "
            "'Variance removed' is the share of the prior variance that the log removed. 'Learnt' "
            "means that the prior comes from this log, because no data sheet gives it. It is a "
            "mean, so σ afterwards may be larger."
        ),
        good=(
            "Coloured bars within the grey ones. The log shows nothing about one that is as wide "
            "as its grey bar."
        ),
        faults=(
            (
                "A value far outside its grey bar: that part is worse than usual, or the value "
                "contains an error that is not in the model."
            ),
        ),
    ),
}
"""By the figure's key, in the order of the page."""
