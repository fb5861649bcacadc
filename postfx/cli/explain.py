"""What `postfx run --explain` says: the plan, and what this run adds to it."""

from __future__ import annotations

import dataclasses
from typing import Any

from postfx.cli.run_up import WatchedRunUp
from postfx.frame import Role
from postfx.io.sequence import Sequence
from postfx.plan import Plan, Skipped
from postfx.strength.shares import Shares


@dataclasses.dataclass(frozen=True)
class Explanation:
    """What would run. left_out: what the arguments leave out, and why; run_up: what runs before first frames."""

    plan: Plan
    sequence: Sequence
    left_out: list[Skipped]
    run_up: WatchedRunUp | None

    def as_dict(self) -> dict[str, Any]:
        """In plain types."""
        plan = self.plan.as_dict()
        plan["skipped"] += [dataclasses.asdict(item) for item in self.left_out]
        if alone := self._alone():
            plan["left_alone"] = alone.as_dict()
        return {**plan, "ahead": self._ahead(), "frames": len(self.sequence), "warnings": self.sequence.warnings}

    def __str__(self) -> str:
        first, lines = self.sequence.numbers[0], [str(self.plan)]
        lines += [f"skips   {item.what}: {item.why}" for item in self.left_out]
        if alone := self._alone():
            lines.append(f"leaves  of frame {first}: {alone}")
        if ahead := self._ahead():
            listed = f"frame{'s' * (len(ahead) > 1)} {', '.join(map(str, ahead))}"
            lines.append(f"run-up  of each shot: {listed} before frame {first} (--run-up 0 for none)")
        return "\n".join(lines + [f"warning {warning}" for warning in self.sequence.warnings])

    def _alone(self) -> Shares | None:
        """What the first frame leaves as it is, where that is asked for."""
        asked = self.sequence.leave and Role.STRENGTH in self.plan.planes
        return self.sequence.left_alone_of(self.sequence.numbers[0]) if asked else None

    def _ahead(self) -> list[int]:
        """Frames that are run before the first one, in the order in which they are."""
        runs = self.run_up and self.plan.accumulating()
        return self.run_up.after(self.sequence.numbers[0])[::-1] if runs else []
