"""Clocks, CAN drivers and the file store keep what their interfaces promise."""

import socket
import threading
import time
from pathlib import Path

import can
import numpy as np
import pytest

from hal.drivers.lockstep_clock import LockstepClock
from hal.drivers.pymavlink_link import PymavlinkLink
from hal.drivers.python_can import PythonCanBus
from hal.drivers.realtime_clock import RealtimeClock
from hal.frame import LINE, as_frame, make_frames
from hal.store import FileStore
from wingbeat.errors import InputError


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("width", [1, 63, 64, 640, 1000, 2048, 4096, 4160])
def test_rows_of_frames_fall_into_all_sets_of_the_cache(width: int, dtype: type) -> None:
    frames = make_frames((2, 200, width), dtype)
    assert frames.shape == (2, 200, width) and not frames.any()
    pitch = frames.strides[1]
    assert width * frames.itemsize < pitch <= width * frames.itemsize + 2 * LINE
    assert len({row * pitch // LINE % 64 for row in range(64)}) == 64
    image = np.random.default_rng(1).integers(0, 255, (200, width)).astype(dtype)
    assert (as_frame(image) == image).all() and as_frame(image).strides == frames.strides[1:]


def test_lockstep_time_goes_where_it_is_sent_and_never_back() -> None:
    clock = LockstepClock(5)
    clock.sleep_until_ns(100)
    clock.sleep_until_ns(50)
    assert clock.now_ns() == 100


def test_realtime_clock_starts_where_told_and_wakes_no_earlier_than_asked() -> None:
    clock = RealtimeClock(1_000_000_000)
    assert 1_000_000_000 <= clock.now_ns() < 1_500_000_000
    deadline = clock.now_ns() + 3_000_000
    clock.sleep_until_ns(deadline)
    assert clock.now_ns() >= deadline
    before = clock.now_ns()
    clock.sleep_until_ns(before - 1)  # the past does not wait


def test_thread_cpu_time_of_one_thread_leaves_out_the_others() -> None:
    clock = RealtimeClock()
    stop = threading.Event()

    def spin() -> None:
        while not stop.is_set():
            sum(range(1000))

    other = threading.Thread(target=spin)
    before_cpu, before_wall = clock.thread_cpu_ns(), clock.wall_ns()
    other.start()
    clock.sleep_until_ns(clock.now_ns() + 50_000_000)
    stop.set()
    other.join()
    assert clock.wall_ns() - before_wall >= 50_000_000
    assert clock.thread_cpu_ns() - before_cpu < 25_000_000


def test_frames_on_the_virtual_bus_arrive_as_sent() -> None:
    listener = can.Bus(interface="virtual", channel="hal-test")
    bus = PythonCanBus("virtual", "hal-test")
    assert bus.send(0x123, b"\x01\x02\x03", 7)
    assert bus.send(0x1ABCDE, bytearray(8), 8)
    short, long = listener.recv(1.0), listener.recv(1.0)
    bus.close()
    listener.shutdown()
    assert short is not None and (short.arbitration_id, bytes(short.data)) == (0x123, b"\x01\x02\x03")
    assert not short.is_extended_id
    assert long is not None and long.is_extended_id
    assert (bus.sent, bus.refused) == (2, 0)


def test_a_frame_that_the_bus_refuses_is_counted() -> None:
    bus = PythonCanBus("virtual", "hal-closed")
    bus.close()
    assert not bus.send(0x100, b"", 0)
    assert (bus.sent, bus.refused) == (0, 1)


@pytest.mark.parametrize("interface", ["no-such-interface", "socketcan"])
def test_a_bus_that_is_not_there_is_one_clear_line(interface: str) -> None:
    with pytest.raises(InputError, match=r"cannot open the CAN bus.*virtual") as caught:
        PythonCanBus(interface, "can-none")
    assert "\n" not in str(caught.value)


def test_a_stream_has_its_name_only_when_it_is_finished(tmp_path: Path) -> None:
    store = FileStore(tmp_path / "run")
    with store.stream("flight.bin") as file:
        file.write(b"abc")
        assert store.read("flight.bin") is None
    assert store.read("flight.bin") == b"abc"
    with pytest.raises(RuntimeError), store.stream("flight.bin") as file:
        file.write(b"half")
        raise RuntimeError
    assert store.read("flight.bin") == b"abc"
    assert store.path("flight.bin.active").exists()


def test_a_folder_that_cannot_be_written_is_one_clear_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        FileStore(tmp_path / "file" / "run")
    with pytest.raises(InputError, match="cannot write"):
        FileStore(tmp_path).write("missing/name", b"")


def test_a_udp_line_carries_bytes_both_ways_and_a_bad_one_is_named() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ground:
        ground.bind(("127.0.0.1", 0))
        ground.settimeout(2.0)
        link = PymavlinkLink(f"udpout:127.0.0.1:{ground.getsockname()[1]}")
        assert link.receive() == b""
        assert link.send(b"down")
        data, flight = ground.recvfrom(100)
        ground.sendto(b"up", flight)
        heard = b""
        for _ in range(200):
            heard += link.receive()
            if heard:
                break
            time.sleep(0.01)
        link.close()
    assert (data, heard) == (b"down", b"up")
    for url in ("nothing", "udpin:127.0.0.1", "udpin:127.0.0.1:port"):
        with pytest.raises(InputError, match=url):
            PymavlinkLink(url)
