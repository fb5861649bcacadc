"""Blocks of a network's nodes: runs without a fork or a join, in an order in which they can be drawn."""

from __future__ import annotations

import heapq
from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple


class Node(NamedTuple):
    """Names of what a node reads and writes, and whether it is constant: it depends on no input of the graph."""

    inputs: Sequence[str]
    outputs: Sequence[str]
    constant: bool = False


def blocks(nodes: Sequence[Node]) -> list[list[int]]:
    """All nodes' numbers, in blocks. Every node comes after those that it reads from.

    A block goes on as long as a node is the only one that reads from the node before, and reads from no other. Constant
    nodes belong to no such run: each stands right before the first node that reads it.
    """
    before, after = _neighbours(nodes)
    following = {a: b for a, (b, *more) in after.items() if not more and len(before[b]) == 1}
    inside = set(following.values())
    heads = [n for n, node in enumerate(nodes) if not node.constant and n not in inside]
    chains = {head: _chain(head, following) for head in heads}
    ordered = [chains[head] for head in _in_order(chains, before)]
    return _with_constants(nodes, ordered)


def _neighbours(nodes: Sequence[Node]) -> tuple[dict[int, list[int]], dict[int, list[int]]]:
    """Of every node that is not constant, those it reads from, and those that read from it."""
    writer = {name: n for n, node in enumerate(nodes) if not node.constant for name in node.outputs if name}
    before, after = defaultdict(list), defaultdict(list)
    for n, node in enumerate(nodes):
        for other in dict.fromkeys(writer[name] for name in node.inputs if name in writer):
            before[n].append(other)
            after[other].append(n)
    return before, after


def _chain(head: int, following: dict[int, int]) -> list[int]:
    chain = [head]
    while chain[-1] in following:
        chain.append(following[chain[-1]])
    return chain


def _in_order(chains: dict[int, list[int]], before: dict[int, list[int]]) -> list[int]:
    """Heads of the chains, each after those it depends on, else in the order of the file."""
    chain_of = {n: head for head, chain in chains.items() for n in chain}
    waits = {head: {chain_of[n] for n in before[head]} for head in chains}
    needed = defaultdict(list)
    for head, others in waits.items():
        for other in others:
            needed[other].append(head)
    ready, ordered = [head for head in chains if not waits[head]], []
    heapq.heapify(ready)
    while ready:
        head = heapq.heappop(ready)
        ordered.append(head)
        for other in needed[head]:
            waits[other].discard(head)
            if not waits[other]:
                heapq.heappush(ready, other)
    return ordered


def _with_constants(nodes: Sequence[Node], chains: list[list[int]]) -> list[list[int]]:
    """The chains with each constant node before its first reader; those that nobody reads come last."""
    writer = {name: n for n, node in enumerate(nodes) if node.constant for name in node.outputs if name}
    placed: set[int] = set()

    def with_constants(n: int) -> Iterator[int]:
        for constant in (writer[name] for name in nodes[n].inputs if name in writer):
            if constant not in placed:
                placed.add(constant)
                yield from with_constants(constant)
        yield n

    found = [[m for n in chain for m in with_constants(n)] for chain in chains]
    left = [n for n, node in enumerate(nodes) if node.constant and n not in placed]
    return [*found, left] if left else found
