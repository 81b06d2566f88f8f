"""A short run of the telemetry chain, for tests: a board that changes, all encoders, all files."""

import math
import os
import shutil
from pathlib import Path

import numpy as np
import pymavlink

from telemetry.board import Board, EventRecord
from telemetry.can_codec import CanEncoder
from telemetry.dictionary import (
    AGE_TICKS,
    AMPLITUDE_COHERENCE,
    AMPLITUDE_MM,
    CHAR,
    CMP,
    DAMPING_RATIO,
    DAMPING_RATIO_SIGMA,
    ESTIMATE_TICK,
    ESTIMATE_TIME_US,
    FLAGS,
    FREQUENCY_HZ,
    FREQUENCY_SIGMA_HZ,
    MATCHED,
    MODE,
    MODE_COUNT,
    MU,
    OBSERVABLE,
    REPROJECTION_RMS_PX,
    TICKS,
    VALID,
    VALIDITY,
    FlightMode,
    flag_bits,
)
from telemetry.events import LIMIT_RED, LOCK_ACQUIRED, MODE_CHANGED
from telemetry.logs import CanLog, MavlinkLog
from telemetry.mavlink_codec import MavlinkEncoder
from telemetry.mavlink_dialect import dialect_xml
from telemetry.recorder import Recorder

TICKS_RUN = 31
PERIOD_NS = 66_666_667
START_NS = 1_700_000_000_123_456_789
CELLS = np.array([[0, column, row] for column in range(2) for row in range(3)])

MODES = (
    {"frequency_hz": 0.714_603, "frequency_sigma_hz": 2.1e-5, "damping_ratio": 0.006_012, "damping_ratio_sigma": 3.1e-5,
     "amplitude_mm": 9.8765, "amplitude_coherence": 0.9987, "valid": True, "flags": []},
    {"frequency_hz": 2.310_11, "frequency_sigma_hz": 4.4e-4, "damping_ratio": 0.0092, "damping_ratio_sigma": 4e-4,
     "amplitude_mm": 0.4321, "amplitude_coherence": 0.91, "valid": False, "flags": ["harmonic", "time_varying"]},
)  # fmt: skip
"""Two modes as modes.json has them."""
STEPS = {"frequency_hz": 1e-5, "frequency_sigma_hz": 1e-6, "damping_ratio": 1e-6, "damping_ratio_sigma": 1e-6,
         "amplitude_mm": 1e-3, "amplitude_coherence": 1e-4}  # fmt: skip


def time_of(tick: int) -> int:
    return START_NS + tick * PERIOD_NS


def board_at(tick: int) -> Board:
    board = Board()
    board.set(MODE, FlightMode.TRACK if tick > 3 else FlightMode.ACQUIRE)
    board.set(TICKS, tick + 1)
    for point, value in ((CHAR, 0.9988), (MU, 0.9999), (CMP, 0.9994), (MATCHED, 255), (REPROJECTION_RMS_PX, 0.0123)):
        board.set(point, value)
    board.set(OBSERVABLE, 1)
    board.set(VALIDITY, tick >= 20)
    if tick >= 20:
        board.set(ESTIMATE_TICK, 18)
        board.set(ESTIMATE_TIME_US, time_of(18) // 1000)
        board.set(MODE_COUNT, len(MODES))
        for slot, mode in enumerate(MODES):
            for point in (FREQUENCY_HZ, FREQUENCY_SIGMA_HZ, DAMPING_RATIO, DAMPING_RATIO_SIGMA, AMPLITUDE_MM,
                          AMPLITUDE_COHERENCE, VALID):  # fmt: skip
                board.set(point, float(mode[point.name]), slot)
            board.set(FLAGS, flag_bits(mode["flags"]), slot)
            board.set(AGE_TICKS, tick - 18, slot)
    return board


def events_at(tick: int) -> list[EventRecord]:
    if tick == 4:
        return [
            EventRecord(LOCK_ACQUIRED.number, tick, time_of(tick), 1, (255.0,)),
            EventRecord(MODE_CHANGED.number, tick, time_of(tick), 2, (1.0, 2.0)),
        ]
    return [EventRecord(LIMIT_RED.number, tick, time_of(tick), 3, (12.0, 0.0, 0.25, math.nan))] if tick == 9 else []


def write_run(folder: Path) -> None:
    """Write can.log, mavlink.tlog and flight.mcap of a short run."""
    can_encoder, mavlink_encoder = CanEncoder(), MavlinkEncoder()
    with (
        CanLog(folder / "can.log") as can_log,
        MavlinkLog(folder / "mavlink.tlog") as mavlink_log,
        Recorder(folder / "flight.mcap", CELLS) as recorder,
    ):
        for tick in range(TICKS_RUN):
            board, time_ns = board_at(tick), time_of(tick)
            xyz_mm = np.arange(18.0).reshape(6, 3) + tick
            xyz_mm[5] = np.nan
            recorder.points(tick, time_ns, xyz_mm, np.full(6, 0.0125))
            can_log.write(time_ns, can_encoder, can_encoder.encode(board, tick, time_ns))
            mavlink_log.write(time_ns, mavlink_encoder.encode(board, tick, time_ns))
            recorder.packets(board, tick, time_ns)
            for record in events_at(tick):
                can_log.write(time_ns, can_encoder, can_encoder.encode_event(record))
                mavlink_log.write(time_ns, mavlink_encoder.encode_event(record))
                recorder.event(record)


def mavlink_environment(folder: Path) -> dict[str, str]:
    """For MAVLink tools in a process of their own: the exported dialect, and a copy of pymavlink in this folder, for
    the tools write the dialect's module into their own package."""
    shipped = Path(pymavlink.__file__).parent
    definitions = folder / "message_definitions" / "v1.0"
    definitions.mkdir(parents=True)
    for name in ("common.xml", "standard.xml", "minimal.xml"):
        shutil.copy(shipped / "dialects" / "v20" / name, definitions)
    (definitions / "wingbeat.xml").write_text(dialect_xml())
    big = ("__pycache__", "v09", "v10", "ardupilotmega*", "all.*", "development.*", "tests", "wingbeat*")
    shutil.copytree(shipped, folder / "pymavlink", ignore=shutil.ignore_patterns(*big))
    return os.environ | {
        "MAVLINK20": "1",
        "MDEF": str(definitions.parent),
        "MAVLINK_DIALECT": "wingbeat",
        "PYTHONPATH": str(folder),
    }
