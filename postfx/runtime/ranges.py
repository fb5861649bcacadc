"""Sets of byte ranges: which parts of an allocation hold data."""

from __future__ import annotations


class Ranges:
    """A set of half-open byte ranges [start, end), kept sorted and merged."""

    def __init__(self, spans: tuple[tuple[int, int], ...] = ()) -> None:
        self.spans = spans

    def copy(self) -> Ranges:
        """An independent copy."""
        return Ranges(self.spans)

    def add(self, start: int, end: int) -> None:
        """Include [start, end)."""
        if self.covers(start, end):
            return
        apart = [span for span in self.spans if span[1] < start or span[0] > end]
        joined = [span for span in self.spans if not (span[1] < start or span[0] > end)]
        merged = (min([start, *(s for s, _ in joined)]), max([end, *(e for _, e in joined)]))
        self.spans = tuple(sorted([*apart, merged]))

    def remove(self, start: int, end: int) -> None:
        """Exclude [start, end)."""
        left = [(s, min(e, start)) for s, e in self.spans if s < start]
        right = [(max(s, end), e) for s, e in self.spans if e > end]
        self.spans = tuple(sorted({*left, *right}))

    def subtract(self, other: Ranges) -> None:
        """Exclude all of another set."""
        for span in other.spans:
            self.remove(*span)

    def covers(self, start: int, end: int) -> bool:
        """Whether every byte of [start, end) is included."""
        return any(s <= start and end <= e for s, e in self.spans)

    def includes(self, other: Ranges) -> bool:
        """Whether every byte of another set is included."""
        return all(self.covers(*span) for span in other.spans)

    def touches(self, other: Ranges) -> bool:
        """Whether any byte of another set is included."""
        return any(s < end and start < e for s, e in self.spans for start, end in other.spans)
