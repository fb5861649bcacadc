"""Who wrote what is read, by address."""

from postfx.tools.report.capture_data import edges


def command(index, reads=(), writes=()):
    named = {"reads": reads, "writes": writes}
    return {"index": index,
            **{k: [{"name": n, "address": list(at)} for n, *at in v] for k, v in named.items()}}


def arrows(*commands):
    return [(edge["from"], edge["to"], edge["tensor"]) for edge in edges(list(commands))]


def test_the_last_writer_counts():
    writes = command(0, writes=[("a", 0, 8)]), command(1, writes=[("a", 0, 8)])
    assert arrows(*writes, command(2, reads=[("view", 0, 8)])) == [(1, 2, "view")]


def test_a_read_of_two_writers_and_of_what_nobody_wrote():
    writes = command(0, writes=[("a", 0, 8)]), command(1, writes=[("b", 4, 8)])
    assert arrows(*writes, command(2, reads=[("c", 0, 12)])) == [(1, 2, "c"), (0, 2, "c"),
                                                                 (None, 2, "c")]


def test_a_command_reads_before_it_writes():
    assert arrows(command(0, reads=[("a", 0, 8)], writes=[("b", 8, 16)])) == [(None, 0, "a")]


def test_empty_tensors_have_no_edges():
    assert arrows(command(0, writes=[("a", 4, 4)]), command(1, reads=[("a", 4, 4)])) == []
