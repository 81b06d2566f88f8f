"""A recording plays back tick by tick, with its gaps as gaps, and bad input is one clear line."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from hal.camera import FrameStatus
from hal.drivers.image_files import find_images
from hal.drivers.lockstep_clock import LockstepClock
from hal.drivers.recorded import RecordedCamera, RecordedTrigger, Recording, open_recording
from hal.frame import make_frames
from wingbeat.errors import InputError

WIDTH, HEIGHT, FRAMES = 24, 16, 5
SIZES = ((WIDTH, HEIGHT), (WIDTH, HEIGHT))
HEADER = "index,left_ns,right_ns,left_trigger,right_trigger\n"


def picture(eye: int, place: int, dtype: type = np.uint8) -> np.ndarray:
    return np.arange(HEIGHT * WIDTH).reshape(HEIGHT, WIDTH).astype(dtype) // 4 + dtype(10 * place + 100 * eye)


def write(folder: Path, eye: int, count: int = FRAMES, dtype: type = np.uint8) -> list[Path]:
    folder.mkdir()
    for place in range(count):
        cv2.imwrite(str(folder / f"{place:06d}.png"), picture(eye, place, dtype))
    return find_images(folder.parent, f"{folder.name}/*.png")


@pytest.fixture
def images(tmp_path: Path) -> tuple[list[Path], list[Path]]:
    return write(tmp_path / "left", 0), write(tmp_path / "right", 1)


def play(recording: Recording) -> list[tuple[int, int, list[int], list[int]]]:
    """(tick, time, frames of the two eyes, their statuses), with each good frame's pixels checked."""
    cameras = [RecordedCamera(recording, eye) for eye in (0, 1)]
    clock = LockstepClock()
    trigger = RecordedTrigger(recording, clock)
    buffers = [make_frames((camera.height, camera.width), camera.dtype) for camera in cameras]
    ticks = []
    while (edge := trigger.wait()) is not None:
        assert clock.now_ns() == edge.time_ns
        stamps = [camera.grab(buffer) for camera, buffer in zip(cameras, buffers, strict=True)]
        for eye, stamp in enumerate(stamps):
            assert stamp.trigger == edge.tick
            if stamp.status == FrameStatus.OK:
                assert np.array_equal(buffers[eye], picture(eye, stamp.frame, buffers[eye].dtype.type))
        ticks.append((edge.tick, edge.time_ns, [s.frame for s in stamps], [s.status for s in stamps]))
    return ticks


def test_without_timestamps_pairs_come_by_index_at_the_rate(images: tuple[list[Path], list[Path]]) -> None:
    ticks = play(open_recording(*images, SIZES, 15.0))
    assert [t[2] for t in ticks] == [[k, k] for k in range(FRAMES)]
    assert [t[1] for t in ticks] == [round(k * 1e9 / 15.0) for k in range(FRAMES)]


def test_sixteen_bit_images_keep_their_bits(tmp_path: Path) -> None:
    eyes = write(tmp_path / "left", 0, dtype=np.uint16), write(tmp_path / "right", 1, dtype=np.uint16)
    recording = open_recording(*eyes, SIZES, 15.0)
    assert recording.dtypes == (np.dtype(np.uint16), np.dtype(np.uint16))
    assert len(play(recording)) == FRAMES


def test_a_gap_in_the_triggers_is_ticks_without_frames(images: tuple[list[Path], list[Path]], tmp_path: Path) -> None:
    stamps = tmp_path / "timestamps.csv"
    triggers = [7, 8, 11, 12, 13]
    stamps.write_text(HEADER + "".join(f"{i},{k * 100},{k * 100 + 3},{k},{k}\n" for i, k in enumerate(triggers)))
    ticks = play(open_recording(*images, SIZES, 15.0, stamps))
    assert [t[0] for t in ticks] == list(range(7))
    assert [t[1] for t in ticks] == [700, 800, 900, 1000, 1100, 1200, 1300]
    missing = [-1, -1]
    assert [t[2] for t in ticks] == [[0, 0], [1, 1], missing, missing, [2, 2], [3, 3], [4, 4]]
    assert ticks[2][3] == [FrameStatus.MISSING] * 2


@pytest.mark.requirement("WB-HAL-01")
def test_one_eyes_dropped_frame_does_not_shift_its_pairs(images: tuple[list[Path], list[Path]], tmp_path: Path) -> None:
    stamps = tmp_path / "timestamps.csv"
    left, right = [0, 1, 2, 3, 4], [0, 2, 3, 4, 5]  # the right eye lost trigger 1, the left one trigger 5
    rows = (f"{i},{a * 100},{b * 100},{a},{b}\n" for i, (a, b) in enumerate(zip(left, right, strict=True)))
    stamps.write_text(HEADER + "".join(rows))
    ticks = play(open_recording(*images, SIZES, 15.0, stamps))
    assert [t[2] for t in ticks] == [[0, 0], [1, -1], [2, 1], [3, 2], [4, 3], [-1, 4]]


def test_empty_cells_say_that_an_eye_has_no_frame(images: tuple[list[Path], list[Path]], tmp_path: Path) -> None:
    stamps = tmp_path / "timestamps.csv"
    rows = [f"{i},{i * 100},{i * 100},{i},{i}" for i in range(FRAMES)]
    rows[2] = "2,,200,,2"
    stamps.write_text(HEADER + "\n".join(rows))
    left = images[0][:2] + images[0][3:]
    recording = open_recording(left, images[1], SIZES, 15.0, stamps)
    assert [frame and frame.path.name for frame in recording.frames[0]] == [
        "000000.png",
        "000001.png",
        None,
        "000003.png",
        "000004.png",
    ]


def test_lines_left_out_of_the_timestamps_are_gaps(images: tuple[list[Path], list[Path]], tmp_path: Path) -> None:
    stamps = tmp_path / "timestamps.csv"
    stamps.write_text(HEADER + "".join(f"{i},{i * 100},{i * 100},{i},{i}\n" for i in (0, 1, 4)))
    ticks = play(open_recording(*images, SIZES, 15.0, stamps))
    assert [t[2] for t in ticks] == [[0, 0], [1, 1], [-1, -1], [-1, -1], [4, 4]]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("1,100,100,1,1\n1,200,200,2,2\n", "index 1, trigger 1, 100 ns comes index 1"),
        ("0,100,100,3,3\n1,200,200,2,2\n", "increase"),
        ("0,200,100,1,1\n1,100,200,2,2\n", "increase"),
        ("0,0,0,65535,65535\n1,100,100,0,0\n", "increase"),
        ("0,0,0,0,0\n1,100,100,999999,999999\n", "gaps of at most"),
        ("0,0,0,0,0\n1,abc,100,1,1\n", "line 3"),
        ("0,0,0,0\n", "five whole numbers"),
        ("0,0,0,,0\n", "leave both cells"),
        ("0,0,0,0,0\n99,100,100,1,1\n", "2 left timestamps for 5 left images"),
        ("", "0 left timestamps"),
    ],
)
def test_timestamps_that_cannot_be_are_refused(
    images: tuple[list[Path], list[Path]], tmp_path: Path, line: str, message: str
) -> None:
    stamps = tmp_path / "timestamps.csv"
    stamps.write_text(HEADER + line)
    with pytest.raises(InputError, match=message):
        open_recording(*images, SIZES, 15.0, stamps)


def test_timestamps_of_eyes_that_never_meet_are_refused(images: tuple[list[Path], list[Path]], tmp_path: Path) -> None:
    stamps = tmp_path / "timestamps.csv"
    stamps.write_text(HEADER + "".join(f"{i},{i},{i},{i},{i + 50}\n" for i in range(FRAMES)))
    with pytest.raises(InputError, match="share no number"):
        open_recording(*images, SIZES, 15.0, stamps)


def test_a_header_of_another_kind_is_refused(images: tuple[list[Path], list[Path]], tmp_path: Path) -> None:
    stamps = tmp_path / "timestamps.csv"
    stamps.write_text("time,left,right\n")
    with pytest.raises(InputError, match="header line"):
        open_recording(*images, SIZES, 15.0, stamps)
    with pytest.raises(InputError, match="cannot read the timestamps"):
        open_recording(*images, SIZES, 15.0, tmp_path / "none.csv")


def colour(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((HEIGHT, WIDTH, 3), np.uint8))


def small(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((HEIGHT, WIDTH - 1), np.uint8))


def deep(path: Path) -> None:
    cv2.imwrite(str(path), np.zeros((HEIGHT, WIDTH), np.uint16))


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-20])


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (colour, "is a colour image"),
        (small, "is 23 x 16 pixels, but the calibration says 24 x 16"),
        (deep, "has 16 bits a pixel"),
        (truncated, "truncated"),
        (lambda path: path.write_bytes(b"no image"), "is no PNG"),
        (lambda path: path.write_bytes(b""), "is no PNG"),
        (lambda path: path.unlink(), "cannot read this image"),
    ],
)
@pytest.mark.requirement("WB-HAL-02")
def test_a_bad_image_is_refused_before_the_first_tick(
    images: tuple[list[Path], list[Path]], spoil: Callable[[Path], object], message: str
) -> None:
    spoil(images[1][3])
    with pytest.raises(InputError, match=message) as caught:
        open_recording(*images, SIZES, 15.0)
    assert "000003.png" in str(caught.value)


@pytest.mark.requirement("WB-HAL-02")
def test_a_damaged_image_is_refused_when_it_is_read_and_the_decoder_stays_silent(
    images: tuple[list[Path], list[Path]], capfd: pytest.CaptureFixture[str]
) -> None:
    data = bytearray(images[0][2].read_bytes())
    data[len(data) // 2] ^= 1
    images[0][2].write_bytes(data)
    with pytest.raises(InputError, match=r"000002\.png: the image is damaged"):
        play(open_recording(*images, SIZES, 15.0))
    assert capfd.readouterr().err == ""


def test_unequal_counts_are_refused(images: tuple[list[Path], list[Path]]) -> None:
    with pytest.raises(InputError, match="5 left images but 4 right images"):
        open_recording(images[0], images[1][:4], SIZES, 15.0)


def test_a_pattern_without_images_is_refused(tmp_path: Path) -> None:
    for pattern in ("left/*.png", str(tmp_path / "*.png"), ""):
        with pytest.raises(InputError, match="pattern"):
            find_images(tmp_path, pattern)


def test_images_sort_by_name_and_absolute_patterns_work(tmp_path: Path) -> None:
    for number in (1, 2, 10):
        (tmp_path / f"f{number}.png").touch()
    names = [path.name for path in find_images(Path(), str(tmp_path / "*.png"))]
    assert names == ["f1.png", "f10.png", "f2.png"]


def test_grabbing_beyond_the_end_is_a_missing_frame(images: tuple[list[Path], list[Path]]) -> None:
    camera = RecordedCamera(open_recording(*images, SIZES, 15.0), 0)
    buffer = make_frames((HEIGHT, WIDTH), np.uint8)
    stamps = [camera.grab(buffer) for _ in range(FRAMES + 2)]
    assert [stamp.status for stamp in stamps[-3:]] == [FrameStatus.OK] + [FrameStatus.MISSING] * 2
