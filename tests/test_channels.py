"""Recorded channels: both forms read alike, and every fault named with its place."""

import numpy as np
import pytest

from fsw.channels import read_channels, read_shapes
from wingbeat.errors import InputError


def write(path, text):
    path.write_text(text)
    return path


def test_npz_and_csv_of_one_record_read_alike(tmp_path):
    time_s, y = np.array([0.0, 0.1, 0.25]), np.array([[1.0, 2.0], [np.nan, 4.0], [5.0, 6.0]])
    np.savez(tmp_path / "a.npz", time_s=time_s, y=y, geometry=np.zeros((2, 3)), u=np.ones((3, 1)))
    write(tmp_path / "a.csv", "time_s,a,b\n0.0,1,2\n0.1,,4\n0.25,5,6\n\n")
    one, two = read_channels(tmp_path / "a.npz"), read_channels(tmp_path / "a.csv")
    assert np.array_equal(one.time_s, two.time_s)
    assert np.array_equal(one.y, two.y, equal_nan=True)
    assert one.geometry.shape == (2, 3) and one.u.shape == (3, 1) and two.geometry is None


def test_a_rate_stands_for_time(tmp_path):
    np.savez(tmp_path / "own.npz", rate_hz=20.0, y=np.ones(4))
    np.savez(tmp_path / "none.npz", y=np.ones((4, 1)))
    assert np.allclose(read_channels(tmp_path / "own.npz", 5.0).time_s, np.arange(4) / 20.0)
    assert np.allclose(read_channels(tmp_path / "none.npz", 5.0).time_s, np.arange(4) / 5.0)
    assert np.allclose(read_channels(write(tmp_path / "b.csv", "a\n1\n2\n"), 4.0).time_s, [0.0, 0.25])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("time_s,a\n0,1\n1,x\n", ["line 3", "column 2", "(a)", "'x'"]),
        ("time_s,a\n0,1\n1\n", ["line 3", "1 cells"]),
        ("time_s,a\n0,1\n0,2\n", ["time_s", "sample 1"]),
        ("time_s,a\n0,1\n,2\n", ["time_s", "sample 1"]),
        ("a,b\n1,2\n3,4\n", ["--rate"]),
        ("0,1\n1,2\n", ["header"]),
        ("", ["empty"]),
        ("time_s,a\n", ["empty"]),
        ("time_s,a\n0,\n1,\n", ["only missing"]),
        ("time_s\n0\n1\n", ["no samples"]),
    ],
)
def test_a_fault_in_a_csv_is_named_with_its_place(tmp_path, text, words):
    with pytest.raises(InputError) as caught:
        read_channels(write(tmp_path / "bad.csv", text))
    assert all(word in str(caught.value) for word in [*words, "bad.csv"])
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("arrays", "words"),
    [
        ({"x": np.ones(3)}, ["no y", "x"]),
        ({"y": np.ones((3, 1))}, ["--rate"]),
        ({"y": np.ones((3, 1)), "rate": 3.0}, ["unknown key rate", "rate_hz"]),
        ({"y": np.ones((3, 1)), "rate_hz": 0.0}, ["rate_hz", "positive"]),
        ({"y": np.ones((3, 1)), "time_s": np.arange(4.0)}, ["time_s", "(3,)"]),
        ({"y": np.ones((3, 1)), "time_s": np.array([0.0, 1.0, 0.5])}, ["sample 2"]),
        ({"y": np.ones((3, 1)), "rate_hz": 1.0, "geometry": np.ones((2, 3))}, ["geometry", "(1, 3)"]),
        ({"y": np.ones((3, 1)), "rate_hz": 1.0, "u": np.ones((2, 1))}, ["u has shape"]),
        ({"y": np.array(["a", "b"]), "rate_hz": 1.0}, ["y is not numeric"]),
        ({"y": np.zeros((0, 2)), "rate_hz": 1.0}, ["no samples"]),
        ({"y": np.ones((2, 2, 2)), "rate_hz": 1.0}, ["(T, channels)"]),
    ],
)
def test_a_fault_in_an_npz_is_named(tmp_path, arrays, words):
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(InputError) as caught:
        read_channels(tmp_path / "bad.npz")
    assert all(word in str(caught.value) for word in [*words, "bad.npz"])


def test_missing_unknown_and_broken_files_are_refused(tmp_path):
    for path, word in [
        (tmp_path / "none.npz", "no such file"),
        (tmp_path, "no such file"),
        (write(tmp_path / "a.txt", "1"), "unknown kind"),
        (write(tmp_path / "a.npz", "no archive"), "not a readable"),
    ]:
        with pytest.raises(InputError, match=word):
            read_channels(path, 1.0)
    binary = tmp_path / "b.csv"
    binary.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(InputError, match="CSV"):
        read_channels(binary, 1.0)
    with pytest.raises(InputError, match="--rate"):
        read_channels(binary, -1.0)


def test_reference_shapes_must_fit_the_channels(tmp_path):
    np.savez(tmp_path / "shapes.npz", shape=np.eye(3))
    assert read_shapes(tmp_path / "shapes.npz", 3).shape == (3, 3)
    with pytest.raises(InputError, match="to fit y"):
        read_shapes(tmp_path / "shapes.npz", 4)
    np.savez(tmp_path / "other.npz", y=np.eye(3))
    with pytest.raises(InputError, match="has no shape"):
        read_shapes(tmp_path / "other.npz", 3)
