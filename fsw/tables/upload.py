"""A table on its way up, in pieces of four bytes, in memory that is taken once."""

from telemetry.events import TableNumber

CHUNK_BYTES = 4
MOST_BYTES = 16 * 1024


class Upload:
    """One table at a time. Pieces may come in any order, and more than once; none goes beyond the announced length."""

    def __init__(self) -> None:
        self.number: TableNumber | None = None
        self.length = 0
        self._bytes = bytearray(MOST_BYTES)
        self._here = bytearray(MOST_BYTES // CHUNK_BYTES)

    def begin(self, number: TableNumber, length: int) -> bool:
        """Expect so many bytes of this table, and forget what came before. False if they are too many: all stays."""
        if not 1 <= length <= MOST_BYTES:
            return False
        self.number, self.length = number, length
        self._here[:] = bytes(len(self._here))
        return True

    def expects(self, chunk: int) -> bool:
        """Whether the announced table has a piece with this number."""
        return self.number is not None and 0 <= chunk < self._chunks

    def put(self, chunk: int, data: bytes) -> bool:
        """Take the piece with this number, counted from 0; False if none such is expected."""
        if not self.expects(chunk) or len(data) != CHUNK_BYTES:
            return False
        self._bytes[chunk * CHUNK_BYTES : (chunk + 1) * CHUNK_BYTES] = data
        self._here[chunk] = 1
        return True

    @property
    def missing(self) -> int:
        """Number of the first piece that has not come; -1 if all are here."""
        return self._here.find(0, 0, self._chunks)

    @property
    def content(self) -> bytes:
        """The bytes as far as they were announced."""
        return bytes(self._bytes[: self.length])

    def end(self) -> None:
        """Expect nothing more."""
        self.number, self.length = None, 0

    @property
    def _chunks(self) -> int:
        return -(-self.length // CHUNK_BYTES)
