"""Options of commands that are made from declarations: parsers, help, checks, all errors."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import pytest
from conftest import raises_with
from pydantic import model_validator

from sero_mj.base.errors import DeclarationError, UsageError
from sero_mj.base.options import (
    Count,
    Duration,
    JointValues,
    Option,
    Options,
    Port,
    Seed,
    Size,
    Time,
    ending,
    positional,
    whole,
)
from sero_mj.cli.export import ExportOptions
from sero_mj.cli.options import add_options, read_options
from sero_mj.cli.record import RecordOptions
from sero_mj.viewer.image.image_options import ImageOptions, VideoOptions

Picture = Annotated[Path, ending(".png", ".jpg")]


class Where(Options):
    """Where to.

    Attributes:
        port: where it is heard.
        folder: for all of it; with 5 % more.
    """

    title: ClassVar[str] = "where it goes"
    port: Port | None = None
    folder: Path | None = None


class Bake(Where):
    """Bakes.

    Attributes:
        cake: what to bake.
        others: further ones.
        kind: of the dough.
        hot: as hot as it can be.
        duration: in the oven, s.
        start: when, s (default: at once).
        size: of the tin, pixels.
        names: who eats it; may be repeated.
        pieces: how many.
        picture: of it.
        sugar: with it.
        shade: how dark.
        angles: of the spoon.
        folder: for the recipe.
    """

    cake: Annotated[str, positional("CAKE")]
    others: Annotated[list[Path], positional("MORE")] = []
    kind: Literal["short", "puff"] = "short"
    hot: bool = False
    duration: Duration = 30.0
    start: Time | None = None
    size: Size = (300, 200)
    names: Annotated[list[str], Option("NAME", ("--for",))] = []
    pieces: Count = 8
    picture: Annotated[Path | None, ending(".png", ".jpg"), Option("OUT", ("-o", "--picture"))] = (
        None
    )
    sugar: Annotated[str | None, Option(bare="white")] = None
    shade: Annotated[int, whole(1, 5)] = 3
    angles: JointValues | None = None
    seed: Seed = 0

    @model_validator(mode="after")
    def _check_sugar(self) -> Self:
        if self.sugar is not None and self.kind == "puff":
            raise ValueError("--sugar is for --kind short")
        return self


class Required(Options):
    """Needs it.

    Attributes:
        out: where to.
    """

    out: Annotated[Path, Option("OUT", ("-o", "--out"))]
    vary: list[str]


def parser_of(kind: type[Options]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="oven")
    add_options(parser, kind)
    return parser


def bake(*arguments: str) -> Bake:
    return read_options(Bake, vars(parser_of(Bake).parse_args([*arguments])))


def test_omitted_options_have_defaults_and_are_known_as_omitted() -> None:
    plain = bake("cake")
    assert (plain.cake, plain.others, plain.kind, plain.hot) == ("cake", [], "short", False)
    assert (plain.duration, plain.size, plain.names, plain.port) == (30.0, (300, 200), [], None)
    assert plain.set_among(*Bake.model_fields) == ["CAKE"]
    same = bake("cake", "--duration", "30", "--for", "me")
    assert same.duration == plain.duration
    assert same.set_among("duration", "names", "hot") == ["--duration", "--for"]


def test_text_becomes_what_is_declared() -> None:
    found = bake(
        "cake", "a", "b", "--kind", "puff", "--hot", "--duration", "1e1", "--start", "0",
        "--size", "640X480", "--for", "me", "--for", "you", "--pieces", "3", "-o", "x.PNG",
        "--port", "80", "--angles", "0,.5,-1.2", "--seed", "7",
    )  # fmt: skip
    assert found.others == [Path("a"), Path("b")]
    assert (found.kind, found.hot, found.duration, found.start) == ("puff", True, 10.0, 0.0)
    assert (found.size, found.names, found.pieces) == ((640, 480), ["me", "you"], 3)
    assert (found.picture, found.port, found.angles) == (Path("x.PNG"), 80, (0.0, 0.5, -1.2))
    assert bake("cake", "--sugar").sugar == "white"
    assert bake("cake", "--sugar", "brown").sugar == "brown"


@pytest.mark.parametrize(
    ("arguments", "key", "said"),
    [
        (["--kind", "puf"], "--kind", "found 'puf'; expected 'short' or 'puff'; did you mean"),
        (["--duration", "0"], "--duration", "found '0'; expected a number above 0"),
        (["--duration", "nan"], "--duration", "found 'nan'; expected a number above 0"),
        (["--duration", "inf"], "--duration", "found 'inf'; expected a number above 0"),
        (["--start=-1"], "--start", "found '-1'; expected a number of 0 or more"),
        (["--size", "12"], "--size", "found '12'; expected WIDTHxHEIGHT, e.g. 1280x800"),
        (["--size", "0x4"], "--size", "found '0x4'; expected WIDTHxHEIGHT"),
        (["--pieces", "1.5"], "--pieces", "found '1.5'; expected a whole number above 0"),
        (["--shade", "6"], "--shade", "found '6'; expected a whole number from 1 to 5"),
        (["--port", "0"], "--port", "found '0'; expected a port from 1 to 65535"),
        (["--seed=-1"], "--seed", "found '-1'; expected a whole number of 0 or more"),
        (["--angles", "1,x"], "--angles", "found '1,x'; expected numbers separated by"),
        (["--angles", "1,nan"], "--angles", "found '1,nan'; expected numbers separated by"),
        (["-o", "x.gif"], "--picture", "found 'x.gif'; expected a name that ends in .png, .jpg"),
        (["--kind", "puff", "--sugar"], "", "--sugar is for --kind short"),
    ],
)
def test_errors_use_the_names_of_the_command_line(
    arguments: list[str], key: str, said: str
) -> None:
    with pytest.raises(DeclarationError) as caught:
        bake("cake", *arguments)
    (problem,) = caught.value.problems
    assert problem.key == key
    assert problem.message.startswith(said)


def test_all_errors_are_reported_at_once() -> None:
    with pytest.raises(DeclarationError) as caught:
        bake("cake", "--port", "x", "--size", "x", "--kind", "x")
    assert {problem.key for problem in caught.value.problems} == {"--port", "--size", "--kind"}


def test_help_shows_docstrings_and_defaults() -> None:
    text = " ".join(parser_of(Bake).format_help().split())
    for said in (
        "usage: oven [-h] [--kind {short,puff}] [--hot] [--duration S] [--start S] [--size WxH] "
        "[--for NAME] [--pieces N] [-o OUT] [--sugar [SUGAR]] [--shade SHADE] [--angles Q]",
        "CAKE what to bake",
        "--kind {short,puff} of the dough (default: short)",
        "--hot as hot as it can be --",
        "--duration S in the oven, s (default: 30)",
        "--start S when, s (default: at once)",
        "--size WxH of the tin, pixels (default: 300x200)",
        "--for NAME who eats it; may be repeated --",
        "--picture OUT of it --",
        "where it goes: --port PORT where it is heard --folder FOLDER for the recipe",
    ):
        assert said in text, said


def test_options_without_a_default_are_required(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        parser_of(Required).parse_args([])
    assert "required: -o/--out, --vary" in capsys.readouterr().err
    given = parser_of(Required).parse_args(["-o", "a", "--vary", "b", "--vary", "c"])
    assert read_options(Required, vars(given)).vary == ["b", "c"]


def test_options_can_be_rejected() -> None:
    bake("cake").refuse(("hot", "names"), " is not for cakes")
    with raises_with(UsageError, reason="--for is not for cakes"):
        bake("cake", "--for", "me").refuse(("hot", "names"), " is not for cakes")


@pytest.mark.parametrize(
    ("clicks", "found"),
    [
        (["3,4"], [(3.0, 4.0, "click", False)]),
        (["3,4,shift", "1.5,2,touch"], [(3.0, 4.0, "shift", False), (1.5, 2.0, "click", True)]),
        (["3,4,touch,double"], [(3.0, 4.0, "double", True)]),
        ([(3.0, 4.0, "hover", False)], [(3.0, 4.0, "hover", False)]),
    ],
)
def test_clicks_are_text_or_values(clicks: list[Any], found: list[Any]) -> None:
    assert ImageOptions(clicks=clicks).clicks == found


@pytest.mark.parametrize("click", ["3", "x,4", "3,4,5", "3,4,shift,double", "3,4,,"])
def test_invalid_clicks_are_rejected(click: str) -> None:
    expected = "X,Y in pixels, or X,Y followed by ,shift ,double ,hover or ,touch"
    with raises_with(key="clicks.0", found=click, expected=expected):
        ImageOptions(clicks=[click])


def test_switches_are_text_or_a_mapping() -> None:
    both = {"arrows": "1", "axes": "0101"}
    assert ImageOptions(shown=["arrows=1", "axes=0101"]).shown == both
    assert ImageOptions(shown=both).shown == both
    assert ImageOptions(shown=None).shown == {}
    with raises_with(
        key="shown", reason="found 'arrows'; expected NAME=0 or NAME=1, for example arrows=1"
    ):
        ImageOptions(shown=["arrows"])


def test_options_copy_common_fields_of_other_options() -> None:
    film = VideoOptions(size=(64, 48), duration=2.0, camera="top")
    picture = ImageOptions.taken_from(film)
    assert (picture.size, picture.camera) == ((64, 48), "top")
    assert "duration" not in vars(picture)


@pytest.mark.parametrize("spelling", ["--seconds", "--duration"])
def test_record_and_export_take_either_spelling_of_the_time(spelling: str) -> None:
    for kind, target, field in (
        (RecordOptions, "run.mcap", "duration"),
        (ExportOptions, "run.html", "seconds"),
    ):
        parser = parser_of(kind)
        options = read_options(kind, vars(parser.parse_args(["lwr_udp", target, spelling, "7"])))
        assert getattr(options, field) == 7.0
