"""Events on their way to the ground: a bounded queue, and a token bucket for each source."""

from collections import deque
from collections.abc import Iterator, Sequence

from telemetry.board import EventRecord
from telemetry.declaration import Event, Severity, Source
from telemetry.events import EVENTS_SUPPRESSED

PLACES = 64
"""Events that wait to be sent. Full: the newest one is suppressed, unless it is critical."""

CRITICAL_PLACES = 256
"""Further places that only critical events take. All sources together raise fewer of them in a tick: see below."""


class EventQueue:
    """Raised events, oldest first; what does not go through is counted, by source.

    Each source may raise `burst` events at once, and one more every refill_ticks. A suppressed event is not lost
    without a word: when its source may speak again, EVENTS_SUPPRESSED tells how many there were. Critical events
    take no token and are never suppressed: a limit turns red once, a task dies once, so their number in a tick is
    bounded by the tables, far below CRITICAL_PLACES; and the queue is emptied in every tick.
    """

    def __init__(self, burst: int, refill_ticks: int) -> None:
        self.raised = 0
        self.suppressed = 0
        self.critical = 0  # raised critical events
        self._burst, self._refill_ticks = burst, refill_ticks
        self._tokens = [burst] * len(Source)
        self._refilled_at = [0] * len(Source)  # tick up to which tokens were given
        self._untold = [0] * len(Source)  # suppressed since the source was last told of
        self._waiting: deque[EventRecord] = deque(maxlen=PLACES + CRITICAL_PLACES)

    def __len__(self) -> int:
        """Events that wait."""
        return len(self._waiting)

    def raise_event(self, event: Event, tick: int, time_ns: int, arguments: Sequence[float]) -> None:
        """Queue an event, or count it as suppressed."""
        self.raised += 1
        self.critical += event.severity is Severity.CRITICAL
        if event.severity is Severity.CRITICAL or (self._take_token(event.source, tick) and len(self) < PLACES):
            self._waiting.append(EventRecord(event.number, tick, time_ns, self.raised, tuple(arguments)))
        else:
            self.suppressed += 1
            self._untold[event.source] += 1

    def take(self, tick: int, time_ns: int) -> Iterator[EventRecord]:
        """The waiting events, oldest first, then what was suppressed of each source that may speak again."""
        while self._waiting:
            yield self._waiting.popleft()
        for source, count in enumerate(self._untold):
            if count and self._take_token(source, tick):
                self._untold[source] = 0
                self.raised += 1
                yield EventRecord(EVENTS_SUPPRESSED.number, tick, time_ns, self.raised, (source, count))

    def _take_token(self, source: int, tick: int) -> bool:
        """Whether the source may raise an event at this tick."""
        earned = (tick - self._refilled_at[source]) // self._refill_ticks
        if earned > 0:
            self._tokens[source] = min(self._burst, self._tokens[source] + earned)
            self._refilled_at[source] += earned * self._refill_ticks
        if self._tokens[source] == 0:
            return False
        self._tokens[source] -= 1
        return True
