"""The sampling period, and how the stamps differ from an even grid."""

from dataclasses import dataclass

#: Relative difference of two rates that does not matter: N differs by 0.25 %.
SAME = 0.005
#: Plausible rates of IMUs, in Hz.
RATES = (1.0, 20_000.0)
#: Rates of nearly all logs of MEMS IMUs, in Hz: if one of two readings of a clock gives such a rate, it is
#: right.
LIKELY_RATES = (10.0, 2_000.0)


@dataclass(frozen=True, kw_only=True)
class Period:
    """A first estimate of the sampling period under one reading of the stamps."""

    #: Period in ns.
    tau_ns: float
    #: Largest relative correction by the fit of all samples if the reading is right.
    error: float = 0.02
    #: Standard deviation of a stamp about its neighbours, in periods.
    jitter: float = 0.0
    #: Greatest common divisor of the steps, in ns.
    resolution_ns: int = 1
    #: Samples in a batch; 1 if samples do not arrive in batches.
    burst: int = 1
    #: Longest step within a batch, in ns.
    pause_ns: float = 0.0
    #: Whether a batch is anchored at its last stamp (otherwise the first).
    last_stamp: bool = True
    #: Whether this stamp is the time of its last sample (otherwise the first).
    last_place: bool = True
    #: Largest lateness in periods, of batches or of a coarse clock; 0 if stamps are near the grid.
    loose: float = 0.0
    #: Whether gaps may be fractions of a period, as between trials.
    free: bool = False
    #: Whether pauses are rare, and samples complete between them.
    paused: bool = False
    #: Whether the period is from the phases of the stamps, because their jitter hides single losses.
    coherent: bool = False
    #: Tick of a clock that is slightly shorter than the period, in ns; otherwise 0.
    tick_ns: float = 0.0
    #: Whether the period has two ticks of the clock, and jitter moves stamps by a tick.
    half_ticks: bool = False
    #: Another period that is as likely, in ns; otherwise 0.
    other_ns: float = 0.0
    #: Length of most steps in ns, if they are nearly equal; otherwise 0.
    usual_ns: float = 0.0
    #: Variance of the wander of the stamps per sample, in periods squared, see `wander.py`.
    wander: float = 0.0

    @property
    def rate_hz(self) -> float:
        return 1e9 / self.tau_ns
