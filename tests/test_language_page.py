"""STRUCTURE.md: its examples run, and strings from its grammar are parsed."""

from __future__ import annotations

import argparse
import random
import re
import shlex
import tomllib
from importlib import resources

import pytest

from sero_mj.base.errors import StructureError
from sero_mj.cli import main, structure
from sero_mj.cli.options import read_options
from sero_mj.data.receive.checksum import CRCS, SUMS
from sero_mj.data.receive.language import KINDS, MAX_PACKET_BYTES, TYPES, parse
from sero_mj.data.receive.source import make_source
from sero_mj.data.receive.structure import Structure

PAGE = resources.files("sero_mj.data.receive").joinpath("STRUCTURE.md").read_text("utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)


def blocks(language: str) -> list[str]:
    found = [text for name, text in BLOCKS if name == language]
    assert found
    return found


@pytest.mark.parametrize("example", blocks("console"))
def test_documented_commands_print_the_documented_output(example: str, capsys) -> None:
    command, *printed = example.splitlines()
    prompt, name, *arguments = shlex.split(command)
    assert (prompt, name) == ("$", "sero-mj")
    with pytest.raises(SystemExit):
        main(arguments)
    out, err = capsys.readouterr()
    assert (out + err).splitlines() == printed


def test_documented_python_runs() -> None:
    for code in blocks("python"):
        assert "assert" in code
        exec(compile(code, "STRUCTURE.md", "exec"), {})


@pytest.mark.extensions
def test_documented_fri_structure_matches_the_receiver() -> None:
    from sero_mj.extensions.fri.receiver import FriLayout
    from sero_mj.extensions.sniff.guess import known_packets

    (table,) = (tomllib.loads(text)["sources"]["fri"] for text in blocks("toml"))
    layout = make_source("fri", table).layout
    assert layout.size == FriLayout().size == 916
    places = {field.name: (field.offset, field.type) for field in layout.fields}
    fields = {field.name: (field.offset, field.type) for field in FriLayout().fields}
    names = {
        "number": "send_counter", "reflected": "reflected_counter", "time": "timestamp",
        "flange": "flange_frame", "commanded_angles": "commanded_before_fri",
        "contact": "tcp_force", "gravity": "gravity_torques",
    }  # fmt: skip
    same = ("temperatures", "joint_angles", "torques", "external_torques")
    for name, other in {**names, **dict(zip(same, same, strict=True))}.items():
        assert places[name] == fields[other]
    assert layout.encode({})[4:8] == (916).to_bytes(2, "little") + b"\x06\x20"
    assert {size: Structure(text).size for size, (text, _) in known_packets().items()} == {
        916: 916,
        376: 376,
    }


def test_other_documented_commands_are_parsed() -> None:
    parser = argparse.ArgumentParser()
    structure.add_to(parser.add_subparsers())
    for line in "\n".join(blocks("bash")).splitlines():
        given = parser.parse_args(shlex.split(line, comments=True)[1:])
        assert read_options(structure.StructureOptions, vars(given)).sniff == 32000


class Grammar:
    """Generates strings by the rules of the grammar in the page."""

    def __init__(self, text: str, seed: int) -> None:
        self.rules = {
            name: re.findall(r'"[^"]*"|\w+|[|,{}\[\]()]', body)
            for name, body in re.findall(r"(\w+)\s+= (.*?) ;\n", text, re.DOTALL)
        }
        self.random = random.Random(seed)
        self.used: set[str] = set()

    def make(self, rule: str) -> str:
        self.used.add(rule)
        tokens = list(self.rules[rule])
        made = self.alternatives(tokens)
        assert not tokens
        return f" {made} " if rule == "item" else made  # required by the rules on names and checks

    def alternatives(self, tokens: list[str]) -> str:
        found = [self.sequence(tokens)]
        while tokens and tokens[0] == "|":
            tokens.pop(0)
            found.append(self.sequence(tokens))
        return self.random.choice(found)

    def sequence(self, tokens: list[str]) -> str:
        made = self.factor(tokens)
        while tokens and tokens[0] == ",":
            tokens.pop(0)
            made += self.factor(tokens)
        return made

    def factor(self, tokens: list[str]) -> str:
        token = tokens.pop(0)
        if token in ("{", "[", "("):
            times = {"{": (0, 0, 1, 2), "[": (0, 1), "(": (1,)}[token]
            made = "".join(
                self.alternatives(list(tokens)) for _ in range(self.random.choice(times))
            )
            self.alternatives(tokens)
            assert tokens.pop(0) == {"{": "}", "[": "]", "(": ")"}[token]
            return made
        if token[0] == '"':
            if tokens[:1] == ["to"]:
                last = tokens[1][1]
                del tokens[:2]
                return chr(self.random.randint(ord(token[1]), ord(last)))
            return token[1:-1]
        return self.make(token)


# Errors by the rules that are not in the grammar.
OTHER_RULES = (
    "is reserved", "a space or a comma before a name", "two items have the name",
    "a count of 1 or more", "would be too long", "a matrix cannot be checked", "a number from",
    "a whole number for this type", "an item that creates an event", "a type with this range",
    "one unsigned number", "the checksum covers",
)  # fmt: skip


@pytest.mark.slow
def test_strings_from_the_grammar_are_parsed() -> None:
    grammar = Grammar(blocks("ebnf")[0], seed=11)
    read = 0
    for _ in range(1500):
        text = grammar.make("structure")
        try:
            parse(text)
        except StructureError as error:
            assert any(reason in error.reason for reason in OTHER_RULES), (text, str(error))
        else:
            read += 1
    assert read > 300
    assert grammar.used == set(grammar.rules)


def test_page_has_all_letters_checksums_and_the_size_limit() -> None:
    grammar = Grammar(blocks("ebnf")[0], seed=0)
    quoted = {
        rule: {token[1:-1] for token in grammar.rules[rule] if token[0] == '"'}
        for rule in ("kind", "type")
    }
    assert quoted == {"kind": set(KINDS), "type": set(TYPES)}
    assert f"is {MAX_PACKET_BYTES} bytes" in PAGE
    names = set(re.findall(r"`([~-]?[a-zA-Z][\w/-]+)`", PAGE))
    assert {*SUMS, *CRCS} <= names
