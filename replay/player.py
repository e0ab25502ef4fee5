"""The player: a recording's samples to the engine in their order of arrival.

What arrived is grouped into blocks as long as that changes nothing: a block ends only where another
stream's sample must come in between for the published solution to be what a user had at the time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator

import numpy as np

from companion.bank import Bank, navigator
from companion.config import Config
from companion.config.settings import uses_direct
from companion.engine import CLOCK_BACK_NS, NOTHING, Engine
from companion.intake.fusion.fusion import fuses
from companion.intake.inertial import CHUNK
from companion.outlet import with_smoothed
from companion.selection import Thinner, in_turn
from companion.types import (
    I64,
    NS,
    AidingSamples,
    AnySamples,
    ImuSamples,
    LogFormatError,
    Outputs,
    VehicleRecording,
)

BLOCK_S = 30.0
"""Longest IMU block handed over at once, so that outputs are drained regularly."""

Sink = Callable[[AnySamples, Outputs], None]


def choose_imu(vehicle: VehicleRecording, config: Config) -> ImuSamples:
    """The inertial stream that ``config`` names, or the reader's best."""
    if not vehicle.imu:
        raise LogFormatError(f"vehicle {vehicle.name}: no inertial data in the log")
    if config.imu.source == "auto":
        return vehicle.imu[0]
    for stream in vehicle.imu:
        if stream.source == config.imu.source:
            return stream
    names = ", ".join(stream.source for stream in vehicle.imu)
    raise LogFormatError(f"no inertial stream '{config.imu.source}' in the log; it has {names}")


def choose_aids(vehicle: VehicleRecording, config: Config) -> list[AidingSamples]:
    """The aiding streams in use: the best of each kind, or the GNSS receiver that is named."""
    if config.raw_gnss.coupling != "off":
        gnss = _raw(vehicle, config)
    else:
        gnss = _fixes(vehicle, config)
    baro = vehicle.baro[:1] if config.baro.use else ()
    mag = (Thinner(config.mag.max_rate_hz)(m) for m in vehicle.mag[:1] if config.mag.use)
    direct = uses_direct(config)
    attitude = vehicle.attitude[:1] if direct and config.direct.attitude else ()
    return [*gnss, *baro, *mag, *attitude, *_further(vehicle, config)]


def _further(vehicle: VehicleRecording, config: Config) -> list[ImuSamples]:
    """The inertial units beside the first one; those that the log does not have stay silent."""
    first = choose_imu(vehicle, config).source if config.further_imu else ""
    found = [s for unit in config.further_imu for s in vehicle.imu if s.source == unit.source]
    if any(stream.source == first for stream in found):
        raise LogFormatError(
            f"inertial stream '{first}' is the first unit and a further one: name the first in "
            "imu.source"
        )
    return found


def _raw(vehicle: VehicleRecording, config: Config) -> list[AidingSamples]:
    """The raw measurements and navigation messages of the receiver that is named."""
    wanted = config.raw_gnss.source
    for at, raw in enumerate(vehicle.raw):
        if wanted in ("auto", raw.source):
            return [*vehicle.broadcast[at : at + 1], raw]
    names = ", ".join(raw.source for raw in vehicle.raw) or "none"
    raise LogFormatError(f"no raw GNSS stream '{wanted}' in the log; it has {names}")


def _fixes(vehicle: VehicleRecording, config: Config) -> list[AidingSamples]:
    """The fixes of the receiver that is named."""
    gnss = [g for g in vehicle.gnss if config.gnss.source in ("auto", g.source)]
    if vehicle.gnss and not gnss:
        names = ", ".join(g.source for g in vehicle.gnss)
        raise LogFormatError(f"no GNSS stream '{config.gnss.source}' in the log; it has {names}")
    return [*gnss[:1]]


def arrivals(
    vehicle: VehicleRecording, config: Config, block_s: float = BLOCK_S
) -> Iterator[AnySamples]:
    """Blocks in order of arrival.

    An aiding sample that arrives before the IMU has reached its time of validity may be handed over
    at any moment up to then; only one that arrives behind it must come exactly at its place. None
    may come before a restart of the IMU's clock that it arrived after: that forgets what waits.
    """
    if fuses(config):
        yield from in_turn([*choose_aids(vehicle, config), choose_imu(vehicle, config)])
        return
    imu = choose_imu(vehicle, config)
    streams = choose_aids(vehicle, config)
    imu_latency = round(config.imu.latency_ms * 1e6)
    latency = {
        "GnssSamples": round(config.gnss.latency_ms * 1e6),
        "BaroSamples": round(config.baro.latency_ms * 1e6),
        "MagSamples": round(config.mag.latency_ms * 1e6),
        "AttitudeSamples": 0,
        "ImuSamples": imu_latency,
        "RawGnssSamples": round(config.raw_gnss.latency_ms * 1e6),
        "BroadcastSamples": 0,
    }
    peak, restarts = _reached(imu.t_ns)
    peak = peak - imu_latency
    # Where each aid falls among the IMU samples, and whether it is late there.
    queue: list[tuple[int, int, int, bool]] = []
    for index, stream in enumerate(streams):
        place = np.searchsorted(imu.seq, stream.seq)
        valid = stream.t_ns - latency[type(stream).__name__]
        late = (place > 0) & (peak[np.maximum(place - 1, 0)] >= valid)
        queue += [
            (q, index, m, x)
            for m, (q, x) in enumerate(zip(stream.seq.tolist(), late.tolist(), strict=True))
        ]
    queue.sort()
    places = np.searchsorted(imu.seq, np.array([q for q, *_ in queue], np.int64))
    step = np.median(np.diff(imu.t_ns)) if len(imu) > 1 else NS
    block = max(1, int(block_s * NS / max(step, 1)))
    sent = 0
    pending: list[tuple[int, int]] = []
    for (_, index, m, behind), place in zip(queue, places.tolist(), strict=True):
        while restarts and restarts[0] < place:
            yield from _aids(streams, pending)
            stop = restarts.popleft() + 1
            yield imu.take(slice(sent, stop))
            sent = stop
        while place - sent > block or (behind and place > sent):
            yield from _aids(streams, pending)
            stop = min(place, sent + block)
            yield imu.take(slice(sent, stop))
            sent = stop
        pending.append((index, m))
        if behind:
            yield from _aids(streams, pending)
    while sent < len(imu):
        yield from _aids(streams, pending)
        yield imu.take(slice(sent, sent + block))
        sent += block
    yield from _aids(streams, pending)


def _reached(t: I64) -> tuple[I64, deque[int]]:
    """The latest time so far at each sample, and where the clock began anew, as the engine sees it.

    Non-finite samples, which it drops, count here: that only makes a block end where it need not.
    """
    peak = np.maximum.accumulate(t)
    restarts: deque[int] = deque()
    if np.any(peak[:-1] - t[1:] > CLOCK_BACK_NS):
        latest = int(t[0])
        for at, now in enumerate(t.tolist()):
            if latest - now > CLOCK_BACK_NS:
                restarts.append(at)
                latest = now
            latest = max(latest, now)
            peak[at] = latest
    return peak, restarts


def _aids(streams: list[AidingSamples], pending: list[tuple[int, int]]) -> Iterator[AidingSamples]:
    """Hand over pending aids, each stream's consecutive ones as a block, and clear the list."""
    by_stream: dict[int, list[int]] = {}
    for index, m in pending:
        by_stream.setdefault(index, []).append(m)
    pending.clear()
    for index, rows in by_stream.items():
        yield streams[index].take(np.array(rows, np.int64))


def blocks(
    vehicle: VehicleRecording, config: Config, block_s: float = BLOCK_S
) -> Iterator[tuple[ImuSamples, list[AidingSamples]]]:
    """The recording cut into blocks of IMU samples, each with the aiding that arrived among it."""
    imu = choose_imu(vehicle, config)
    streams = choose_aids(vehicle, config)
    step = np.median(np.diff(imu.t_ns)) if len(imu) > 1 else NS
    size = min(max(1, int(block_s * NS / max(step, 1))), CHUNK)
    begins = np.arange(0, max(len(imu), 1), size)
    # A block takes what arrived before the next one begins.
    ends = [np.append(np.searchsorted(s.seq, imu.seq[begins[1:]]), len(s)) for s in streams]
    done = [0] * len(streams)
    for n, begin in enumerate(begins.tolist()):
        among = []
        for index, stream in enumerate(streams):
            end = int(ends[index][n])
            if end > done[index]:
                among.append(stream.take(slice(done[index], end)))
            done[index] = end
        yield imu.take(slice(begin, begin + size)), among


def play(
    vehicle: VehicleRecording,
    config: Config,
    sink: Sink | None = None,
    block_s: float = BLOCK_S,
) -> Engine | Bank:
    """Run a recording through a new engine; ``sink`` gets every arrival with what came of it.

    What came of a block and the aiding among it comes with the block's inertial samples.
    ``block_s``: longest block [s]. It changes how often there is something to see, and nothing of
    the solution.
    """
    engine = navigator(config)
    if engine.on_line.running is not None:
        for since_ns, until_ns in vehicle.smoothing_gaps:
            engine.on_line.running.give_way(since_ns, until_ns)
    last: AnySamples | None = None
    for imu, aids in blocks(vehicle, config, block_s):
        out = with_smoothed(engine.step_block(imu, aids), engine.smooth())
        last = imu
        if sink is not None:
            for samples in aids:
                sink(samples, NOTHING)
            sink(imu, out)
    out = with_smoothed(engine.finish(), engine.smooth())
    if sink is not None and last is not None:
        sink(last.take(slice(0, 0)), out)
    return engine
