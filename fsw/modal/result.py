"""What an identification gives: modes with intervals, indicators, validity and flags; and its form in modes.json."""

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from fsw.modal.subspace import Subspace

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Kind = Literal["decay", "ambient"]
Method = Literal["refined", "paper", "rdt_era_dc", "ssi_data"]


@dataclass(frozen=True)
class Options:
    """Settings of an identification; the defaults suit free decays and ambient records alike.

    coordinates: most principal coordinates. block_rows: most block rows of a Hankel matrix. order: highest
    order tried. drift_degree: of the polynomial under a decay. most_modes. minimum_amplitude: in the
    channels' unit, below which a mode is not observable whatever the noise. correlation: "auto" takes the
    form that suits the kind. method: "refined" is the own one; "paper" the fusion of "rdt_era_dc" and
    "ssi_data", which can each be had alone. weighting: of the Hankel matrix, for the paper's methods.
    """

    coordinates: int = 12
    block_rows: int = 30
    order: int = 24
    drift_degree: int = 2
    most_modes: int = 10
    minimum_amplitude: float = 0.0
    correlation: Literal["auto", "fixed_window", "spectral"] = "auto"
    method: Method = "refined"
    weighting: Literal["none", "cva"] = "none"


@dataclass(frozen=True)
class Mode:
    """One identified mode.

    amplitude: of the largest channel in its unit, at the record's start for a decay, sqrt(2) rms for ambient
    response. shape (M,) complex: largest channel 1, NaN for channels not used. damping_ratio is NaN where it
    would mislead. valid only if flags is empty.
    """

    frequency_hz: float
    frequency_sigma_hz: float
    damping_ratio: float
    damping_ratio_sigma: float
    amplitude: float
    amplitude_coherence: float
    singular_value: float
    shape: ComplexArray
    valid: bool
    flags: list[str]

    def flagged(self, flag: str) -> "Mode":
        """The same mode with this against it: not valid."""
        return replace(self, valid=False, flags=sorted({*self.flags, flag}))


@dataclass(frozen=True)
class Record:
    """Extent of a record: duration, samples used, nominal rate; begin_s: after the first sample, where it was cut."""

    duration_s: float
    samples: int
    rate_hz: float
    begin_s: float = 0.0


@dataclass(frozen=True)
class Diagram:
    """Arrays for the report: stabilisation diagram (one entry a pole) and the channels' rms amplitude spectrum."""

    order: NDArray[np.int64]
    frequency_hz: FloatArray
    damping_ratio: FloatArray
    stable: NDArray[np.bool_]
    spectrum_hz: FloatArray
    spectrum: FloatArray


def empty_diagram() -> Diagram:
    """A diagram without poles or spectrum."""
    none = np.zeros(0)
    return Diagram(none.astype(np.int64), none, none, none.astype(np.bool_), none, none)


@dataclass(frozen=True)
class ModalResult:
    """Modes in order of frequency, flags of the record, its extent and kind, and arrays for the report.

    subspace: for the identification of the next record that overlaps with this one.
    """

    modes: list[Mode]
    flags: list[str]
    record: Record
    kind: Kind
    diagram: Diagram = field(default_factory=empty_diagram)
    subspace: Subspace | None = None

    @property
    def valid_modes(self) -> list[Mode]:
        """The modes that every gate agrees on."""
        return [mode for mode in self.modes if mode.valid]


def to_contract(result: ModalResult) -> dict[str, Any]:
    """The result as the structure of modes.json; numbers that are not known are null."""
    return {
        "modes": [
            {
                "frequency_hz": _number(mode.frequency_hz),
                "frequency_sigma_hz": _number(mode.frequency_sigma_hz),
                "damping_ratio": _number(mode.damping_ratio),
                "damping_ratio_sigma": _number(mode.damping_ratio_sigma),
                "amplitude_mm": _number(mode.amplitude),
                "amplitude_coherence": _number(mode.amplitude_coherence),
                "singular_value": _number(mode.singular_value),
                "valid": mode.valid,
                "flags": list(mode.flags),
            }
            for mode in result.modes
        ],
        "flags": list(result.flags),
        "record": {
            "duration_s": result.record.duration_s,
            "samples": result.record.samples,
            "rate_hz": result.record.rate_hz,
            "begin_s": result.record.begin_s,
        },
        "kind": result.kind,
    }


def normalised(shape: ComplexArray, live: NDArray[np.bool_]) -> ComplexArray:
    """Shape (M,) over all channels with its largest entry 1; NaN where a channel was not used."""
    full = np.full(len(live), np.nan + 0j, np.complex128)
    peak = shape[int(np.argmax(np.abs(shape)))]
    full[live] = shape / peak if peak != 0.0 else shape
    return full


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
