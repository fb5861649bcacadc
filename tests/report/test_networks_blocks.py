"""Blocks: runs without fork or join, in an order in which everything comes after what it reads."""

import random

from postfx.tools.report.networks import Node, blocks


def test_a_run_ends_where_the_graph_forks_or_joins():
    nodes = [
        Node(["x"], ["a"]), Node(["a"], ["b"]),  # x -> a -> b, which two read
        Node(["b"], ["c"]), Node(["c"], ["d"]),
        Node(["b", "d"], ["e"]), Node(["e"], ["f"]),
    ]  # fmt: skip
    assert blocks(nodes) == [[0, 1], [2, 3], [4, 5]]


def test_constants_stand_before_their_first_reader():
    nodes = [
        Node(["w"], ["half"], constant=True), Node(["half"], ["weight"], constant=True),
        Node(["unread"], ["nothing"], constant=True),
        Node(["x"], ["a"]), Node(["a", "weight"], ["b"]), Node(["b", "weight"], ["c"]),
    ]  # fmt: skip
    assert blocks(nodes) == [[3, 0, 1, 4, 5], [2]]


def test_branches_that_lie_mixed_in_the_file_are_drawn_one_after_the_other():
    nodes = [
        Node(["x"], ["a"]), Node(["a"], ["left"]), Node(["a"], ["right"]),
        Node(["left"], ["left2"]), Node(["right"], ["right2"]), Node(["left2", "right2"], ["y"]),
    ]  # fmt: skip
    assert blocks(nodes) == [[0], [1, 3], [2, 4], [5]]


def test_one_reader_that_reads_twice_goes_on():
    assert blocks([Node(["x"], ["a"]), Node(["a", "a"], ["b"])]) == [[0, 1]]


def test_random_graphs_are_complete_and_in_order():
    for seed in range(200):
        choose = random.Random(seed)
        nodes = []
        for n in range(choose.randint(1, 30)):
            inputs = [f"v{choose.randrange(n)}" for _ in range(choose.randint(0, 3))] if n else []
            varying = (any(not nodes[int(name[1:])].constant for name in inputs)
                       or choose.random() < 0.3)
            nodes.append(Node(inputs + ["x"] * (varying and not inputs), [f"v{n}"], not varying))
        order = [n for block in blocks(nodes) for n in block]
        assert sorted(order) == list(range(len(nodes))), seed
        place = {f"v{n}": at for at, n in enumerate(order)}
        assert all(place[name] < place[f"v{n}"] for n in order
                   for name in nodes[n].inputs if name != "x"), seed
