"""The plan for frames of one spec: which passes run, in what order, which planes must be read for
them, and what is skipped and why."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from postfx.errors import MissingPlaneError, PassContractError
from postfx.frame import FrameSpec, Role
from postfx.passes import Pass, Reflection

KEPT_PLANES = (Role.COLOUR, Role.ALPHA, Role.OVERLAY)
"""Planes that are wanted in the output even when no pass touches them."""
NO_GUIDES = "none: albedo, normals and depth at output size would make edges sharper (--guides)"


@dataclass(frozen=True)
class Step:
    """One active pass: its name in this plan, the spec that it gets, and its reflection for that
    spec."""

    name: str
    instance: Pass
    input: FrameSpec
    reflection: Reflection

    @cached_property
    def shapes(self) -> dict[Role, tuple[int, int, int]]:
        """The planes that it leaves, in the order of `Role`, and the shape of each."""
        after = self.reflection.output
        return {role: (after.height, after.width, channels) for role, channels in after.planes}

    @property
    def uses(self) -> tuple[Role, ...]:
        """Planes it reads here, optional ones included, in the order of `Role`."""
        wanted = {*self.reflection.reads, *self.reflection.may_read}
        return tuple(role for role in self.input.roles if role in wanted)

    @property
    def resizes(self) -> bool:
        """Whether its output is of another size than its input."""
        after = self.reflection.output
        return (self.input.width, self.input.height) != (after.width, after.height)

    @property
    def uses_guides(self) -> tuple[Role, ...]:
        """Guides it reads here, in the order of `Role`."""
        return tuple(role
                     for role in self.input.guide_roles if role in self.reflection.may_read_guides)


@dataclass(frozen=True)
class Skip:
    """Something that is left out, and why."""

    what: str
    why: str


@dataclass(frozen=True)
class Plan:
    """What happens to frames of one spec.

    Attributes:
        available: spec of the frame as it is offered.
        planes: roles that must be read, in the order of `Role`; everything else may stay in the
            file.
        steps: active passes in order.
        skips: passes and planes that are left out, and why.
        remarks: remarks of the active passes on the result.
        output: spec of the frame that comes out.
        guides: roles of the guides that must be read, likewise.
        parts: names of the parts of the picture that must be read, likewise.
    """

    available: FrameSpec
    planes: tuple[Role, ...]
    steps: tuple[Step, ...]
    skips: tuple[Skip, ...]
    output: FrameSpec
    remarks: tuple[str, ...] = ()
    guides: tuple[Role, ...] = ()
    parts: tuple[str, ...] = ()

    @cached_property
    def input(self) -> FrameSpec:
        """Spec of the frame once only the planes and guides that are needed were read."""
        return _restrict(self.available, self.planes, self.guides, self.parts)

    def accumulating_steps(self) -> tuple[Step, ...]:
        """The steps up to the last one whose results improve with earlier frames; empty if no
        step's do."""
        last = max((at for at, step in enumerate(self.steps, 1)
                    if step.instance.accumulates(step.input)), default=0)
        return self.steps[:last]

    def as_dict(self) -> dict[str, Any]:
        """The plan in plain types, as `to_json` writes it."""
        return {
            "input": _spec_dict(self.available),
            "planes": [str(role) for role in self.planes],
            "guides": [str(role) for role in self.guides],
            "parts": list(self.parts),
            "passes": [_step_dict(step) for step in self.steps],
            "skipped": [{"what": item.what, "why": item.why} for item in self.skips],
            "remarks": list(self.remarks),
            "output": _spec_dict(self.output),
        }

    def to_json(self) -> str:
        """The plan as one JSON object."""
        return json.dumps(self.as_dict(), indent=2)

    def __str__(self) -> str:
        lines = [("frame", _spec_text(self.available)), ("reads", _names(self.planes))]
        lines += [("guides", text) for text in self._guides_text()]
        lines += [("parts", ", ".join(self.parts))] if self.parts else []
        lines += [(f"pass {number}", _step_text(step)) for number, step in enumerate(self.steps, 1)]
        lines += [("skips", f"{item.what}: {item.why}") for item in self.skips]
        lines += [("note", remark) for remark in self.remarks]
        lines += [("output", _spec_text(self.output))]
        return "\n".join(f"{head:<8}{text}" for head, text in lines)

    def _guides_text(self) -> list[str]:
        """A line on planes at output size; none if frames have none and no pass could use any."""
        offered, read = self.available.guides, from_files(self.guides)
        if offered is None or not from_files(offered.roles):
            wanted = any(step.resizes and step.reflection.may_read_guides for step in self.steps)
            return [NO_GUIDES] if wanted else []
        used = f"used: {_names(read)}" if read else "not used"
        return [f"{offered.width}x{offered.height}, {used}"]


def make_plan(passes: Sequence[Pass], spec: FrameSpec) -> Plan:
    """The plan for frames of `spec`, which may hold more planes than are needed.

    Raises MissingPlaneError when a pass needs a plane that neither the frame nor an earlier pass
    provides, PassContractError when a pass declares an output that cannot be.
    """
    steps: list[Step] = []
    skipped: list[Skip] = []
    current = spec
    for instance, name in zip(passes, _step_names(passes), strict=True):
        reason = instance.skip(current)
        if reason is not None:
            skipped.append(Skip(name, reason))
            continue
        step = Step(name, instance, current, instance.reflect(current))
        _check(step, spec)
        steps.append(step)
        current = step.reflection.output
    planes, guides = _find_needed(spec, steps), _needed_guides(spec, steps)
    skipped += [Skip(f"AOV '{role}'", "no pass reads it")
                for role in spec.roles if role not in planes]
    skipped += _unread_guides(spec, guides)
    read = {name for step in steps for name in step.reflection.parts}
    parts = tuple(name for name in spec.part_names if name in read)
    skipped += [Skip(f"part '{name}'", "no pass reads it")
                for name in spec.part_names if name not in parts]
    return _narrow(Plan(spec, planes, tuple(steps), tuple(skipped), current, guides=guides,
                        parts=parts))


def _narrow(plan: Plan) -> Plan:
    """The plan with specs that hold only the planes that are read, as the passes will see them."""
    current = plan.input
    steps = []
    for step in plan.steps:
        steps.append(Step(step.name, step.instance, current, step.instance.reflect(current)))
        current = steps[-1].reflection.output
    remarks = [f"{step.name}: {remark}" for step in steps
               for remark in step.instance.remarks(step.input)]
    if current.has(Role.OVERLAY) and current.encoding != "scene-linear":
        remarks.append("the overlay is not composited: put the pass overlay before the one that "
                       "tone-maps")
    return replace(plan, steps=tuple(steps), output=current, remarks=tuple(remarks))


def _find_needed(spec: FrameSpec, steps: Iterable[Step]) -> tuple[Role, ...]:
    needed: set[Role] = set()
    provided: set[Role] = set()
    for step in steps:
        needed |= set(step.uses) - provided
        provided |= set(step.reflection.writes)
    needed |= set(KEPT_PLANES) - provided
    return tuple(role for role in spec.roles if role in needed)


def _needed_guides(spec: FrameSpec, steps: Iterable[Step]) -> tuple[Role, ...]:
    used = {role for step in steps for role in step.uses_guides}
    return tuple(role for role in spec.guide_roles if role in used)


def _unread_guides(spec: FrameSpec, used: Sequence[Role]) -> list[Skip]:
    if spec.guide_roles and not used:
        return [Skip("guides", "no pass reads them")]
    return [Skip(f"guide '{role}'", "no pass reads it")
            for role in spec.guide_roles if role not in used]


def _check(step: Step, spec: FrameSpec) -> None:
    """Raise MissingPlaneError if a step lacks a plane, PassContractError if it declares an output
    that cannot be. spec: of the frames that the plan is for."""
    missing = [role for role in step.reflection.reads if not step.input.has(role)]
    if missing:
        dropped = ("an earlier pass dropped it" if spec.has(missing[0])
                   else "the frame does not have it")
        fix = "render it, name it in a profile, or leave the pass out"
        raise MissingPlaneError(f"pass '{step.name}' needs AOV '{missing[0]}', but {dropped}: "
                                f"{fix}")
    output, writes = step.reflection.output, step.reflection.writes
    kept = [role for role in output.roles if role not in writes]
    invented = [role for role in kept if not step.input.has(role)]
    invented += set(output.guide_roles) - set(step.input.guide_roles)
    if invented or not set(writes) <= set(output.roles):
        raise PassContractError(f"pass '{step.name}' declares an output of other planes than it "
                                "keeps and writes")
    if kept and (output.width, output.height) != (step.input.width, step.input.height):
        raise PassContractError(f"pass '{step.name}' changes the size but keeps plane '{kept[0]}' "
                                "at the old one")


def _step_names(passes: Sequence[Pass]) -> list[str]:
    """Names of the passes; a second pass of the same name gets a number."""
    plain = [instance.name for instance in passes]
    counts = [plain[: index + 1].count(name) for index, name in enumerate(plain)]
    return [name if count == 1 else f"{name} {count}"
            for name, count in zip(plain, counts, strict=True)]


def _restrict(spec: FrameSpec, roles: Sequence[Role], guides: Sequence[Role],
              parts: Sequence[str]) -> FrameSpec:
    """The spec with these planes and guides only; guides keep their size even if none is read, for
    the output's size."""
    kept = replace(spec.guides, roles=tuple(guides)) if spec.guides else None
    held = [(name, channels) for name, channels in spec.parts if name in parts]
    return FrameSpec(spec.width, spec.height, roles, spec.encoding, kept, spec.source, held)


def _step_text(step: Step) -> str:
    before, after = step.input, step.reflection.output
    sizes = f"{before.width}x{before.height} -> {after.width}x{after.height}"
    changes = [sizes] if step.resizes else []
    changes += ([f"{before.encoding} -> {after.encoding}"] if before.encoding != after.encoding
                else [])
    text = f"{step.name}: reads {_names(step.uses)}; writes {_names(step.reflection.writes)}"
    changes += ["uses the guides"] if from_files(step.uses_guides) else []
    return "; ".join([text, *changes, *step.reflection.notes])


def _step_dict(step: Step) -> dict[str, Any]:
    uses, writes = [str(role) for role in step.uses], [str(role) for role in step.reflection.writes]
    guides = [str(role) for role in step.uses_guides]
    output = _spec_dict(step.reflection.output)
    return {"name": step.name, "reads": uses, "guides": guides, "writes": writes, "output": output,
            "notes": list(step.reflection.notes)}


def _spec_text(spec: FrameSpec) -> str:
    return f"{spec.width}x{spec.height}, {spec.encoding}: {_names(spec.roles)}"


def _spec_dict(spec: FrameSpec) -> dict[str, Any]:
    planes, guides = [str(role) for role in spec.roles], spec.guides
    size = guides and {"width": guides.width, "height": guides.height,
                       "planes": [str(role) for role in guides.roles]}
    return {"width": spec.width, "height": spec.height, "encoding": spec.encoding, "planes": planes,
            "guides": size}


def from_files(guides: Iterable[Role]) -> tuple[Role, ...]:
    """Guides without the one made from the sequence itself."""
    return tuple(role for role in guides if role is not Role.LATER)


def _names(roles: Iterable[Role]) -> str:
    return ", ".join(roles) or "nothing"
