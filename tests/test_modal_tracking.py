"""A mode keeps its slot from one estimate to the next: what is told apart by frequency, by shape, and by patience."""

import numpy as np
import pytest

from fsw.modal.result import Mode
from fsw.modal.tracking import PATIENCE, Holder, assign_slots

X = np.linspace(0.1, 1.0, 12)
SHAPES = {"bending": X**2, "in plane": np.sign(X - 0.5) * X, "torsion": np.sin(9.0 * X), "noise": np.cos(31.0 * X)}
FREE = (None,) * 8


def mode(hz, shape="bending", flags=(), sigma_hz=1e-4):
    return Mode(hz, sigma_hz, 0.005, 1e-4, 5.0, 0.99, 1.0, SHAPES[shape] + 0j, not flags, list(flags))


def slots_of(*estimates, holders=FREE):
    """Slots of each estimate's modes, one estimate after the other."""
    told = []
    for modes in estimates:
        slots, holders = assign_slots(modes, holders)
        told.append(list(slots))
    return told


A, B, C = mode(0.73), mode(3.0, "torsion"), mode(4.2, "in plane")
WEAK = mode(0.4, "noise", ("weak",))

TABLE = {
    "the first estimate is in order of frequency": ([[A, B, C]], [[0, 1, 2]]),
    "nothing changes": ([[A, B], [A, B]], [[0, 1], [0, 1]]),
    "a spurious candidate below moves nobody": ([[A, B], [WEAK, A, B], [A, B]], [[0, 1], [2, 0, 1], [0, 1]]),
    "what was never clean gives its slot back at once": (
        [[A, WEAK], [A], [A, B]],
        [[0, 1], [0], [0, 1]],
    ),
    "a mode is lost and found": ([[A, B, C], [B, C], [A, B, C]], [[0, 1, 2], [1, 2], [0, 1, 2]]),
    "a new mode does not take the slot of a lost one": (
        [[A, B], [B], [B, C], [A, B, C]],
        [[0, 1], [1], [1, 2], [0, 1, 2]],
    ),
    "an estimate without modes says nothing": ([[A, B], *[[]] * (PATIENCE + 5), [B]], None),
    "neighbours cross": (
        [
            [mode(0.7500, "bending"), mode(0.7520, "in plane")],
            [mode(0.7508, "bending"), mode(0.7512, "in plane")],
            [mode(0.7504, "in plane"), mode(0.7516, "bending")],
            [mode(0.7496, "in plane"), mode(0.7524, "bending")],
        ],
        [[0, 1], [0, 1], [1, 0], [1, 0]],
    ),
    "a close pair of which one is lost": (
        [[mode(0.752, "bending"), mode(0.753, "in plane")], [mode(0.7526, "in plane")]],
        [[0, 1], [1]],
    ),
    "a frequency that wanders within its sigmas": (
        [[mode(0.70, sigma_hz=0.004), B], [mode(0.712, "noise", sigma_hz=0.004), B]],
        [[0, 1], [0, 1]],
    ),
    "a frequency that changed is the same mode by its shape": ([[A, B], [mode(0.69), B]], [[0, 1], [0, 1]]),
    "another shape elsewhere is another mode": ([[A, B], [mode(0.69, "noise"), B]], [[0, 1], [2, 1]]),
    "a flagged one elsewhere is not believed to have moved": (
        [[A, B], [mode(0.69, flags=("imprecise",)), B], [A, B]],
        [[0, 1], [2, 1], [0, 1]],
    ),
    "beyond a tenth no shape makes it the same": ([[A], [mode(0.85)]], [[0], [1]]),
    "the clean one of two alike": ([[A], [mode(0.7299, flags=("split",)), mode(0.7302)]], [[0], [1, 0]]),
    "twice in one estimate, the nearer one keeps it": ([[A], [mode(0.7301), mode(0.732)]], [[0], [0, 1]]),
}


@pytest.mark.requirement("WB-MOD-08")
@pytest.mark.parametrize("case", [name for name, (_, told) in TABLE.items() if told is not None])
def test_a_mode_keeps_its_slot_from_one_estimate_to_the_next(case):
    estimates, told = TABLE[case]
    assert slots_of(*estimates) == told


def test_an_estimate_without_modes_says_nothing():
    assert slots_of(*TABLE["an estimate without modes says nothing"][0])[-1] == [1]


@pytest.mark.requirement("WB-MOD-08")
def test_a_slot_is_free_after_so_many_estimates_without_its_mode():
    assert slots_of([A, B], *[[B]] * (PATIENCE - 1), [B, C])[-1] == [1, 0]
    assert slots_of([A, B], *[[B]] * (PATIENCE - 2), [B, C], [A, B, C])[-2:] == [[1, 2], [0, 1, 2]]


def test_with_all_slots_held_the_one_left_longest_ago_is_given_away():
    first = [mode(1.0 + k, "noise") for k in range(8)]
    told = slots_of(first, first[:3] + first[4:], first[:3] + first[5:], [*first[:3], *first[5:], mode(20.0)])
    assert told[-1] == [0, 1, 2, 5, 6, 7, 3]


def test_the_shape_of_a_clean_mode_is_not_lost_to_a_disturbance():
    disturbed = mode(0.7302, "noise", ("not_exponential",))
    _, holders = assign_slots([A], FREE)
    slots, holders = assign_slots([disturbed], holders)
    assert slots == (0,) and np.array_equal(holders[0].shape, A.shape) and holders[0].frequency_hz == 0.7302


def test_shapes_are_compared_where_both_were_measured_and_frequency_decides_where_none_was():
    half, other_half = A.shape.copy(), A.shape.copy()
    half[:6], other_half[6:] = np.nan, np.nan
    near, far = Holder(0.73, 1e-4, half, True), Holder(0.69, 1e-4, half, True)
    for shape, slots in ((A.shape, (0,)), (other_half, (0,))):
        seen = Mode(0.731, 1e-4, 0.005, 1e-4, 5.0, 0.99, 1.0, shape, True, [])
        assert assign_slots([seen], (near, None))[0] == slots
        moved = assign_slots([seen], (far, None))[0]
        assert moved == ((0,) if shape is A.shape else (1,))


def test_slots_are_a_function_of_what_was_seen():
    rng = np.random.default_rng(5)
    estimates = [
        [
            mode(hz * (1.0 + 1e-3 * rng.standard_normal()), shape)
            for hz, shape in ((0.73, "bending"), (0.76, "in plane"))
        ]
        for _ in range(30)
    ]
    assert slots_of(*estimates) == slots_of(*estimates)
    assert slots_of(*estimates) == [[0, 1]] * 30


def test_a_flag_makes_a_mode_not_valid_and_leaves_the_rest():
    valid = mode(0.7)
    once = valid.flagged("weak")
    assert (once.valid, once.flags, valid.flags) == (False, ["weak"], [])
    assert once.flagged("harmonic").flags == ["harmonic", "weak"] and once.flagged("weak").flags == ["weak"]
    assert (once.frequency_hz, once.shape is valid.shape) == (0.7, True)
