"""Panels as text: columns, digits of equal width, corners, and compositing over an image."""

from __future__ import annotations

from importlib import resources

import numpy as np
import pytest

from sero_mj.viewer.decor.font import drawable, line_of, value_columns
from sero_mj.viewer.decor.joint_titles import short_joint_names
from sero_mj.viewer.decor.panels import Panels
from sero_mj.viewer.image.typesetting import (
    PlacedPanel,
    PlacedText,
    Typesetter,
    compose,
)

BLACK = (0.0, 0.0, 0.0, 1.0)
VALUES = [b"A2  cmd   -12.5 Nm", b"    pos   3.0625 rad", b"    limit no data"]


@pytest.fixture(scope="module")
def setter() -> Typesetter:
    return Typesetter(28)


def panel_of(setter: Typesetter, lines: list[bytes], extra: float = 30.0) -> np.ndarray:
    """Returns the pixels of one panel with values."""
    size = np.array([[setter.font.block_width(lines) + extra, 28 * len(lines) + 10.0]])
    (placed,) = setter.place([Panels(size / 2, size, [lines], BLACK, has_values=True)])
    return placed.pixels


def test_lines_that_end_in_a_number_are_split() -> None:
    first, second, third = value_columns(VALUES, len).rows
    assert (first.name, first.label, first.whole, first.rest, first.unit) == (
        "A2", "cmd", "-12", ".5", " Nm",
    )  # fmt: skip
    assert (second.name, second.label, second.tail) == ("", "pos", ".0625 rad")
    assert third.is_missing and third.whole == "no data"
    assert value_columns([b"push: force", b"  in world"], len).rows == ["push: force", "  in world"]
    (large,) = value_columns([b"A1 -1.250e+07 Nm"], len).rows
    assert (large.whole, large.rest) == ("-1", ".250e+07")


def test_panel_is_as_wide_as_its_columns() -> None:
    # Name, gap, label, gap, integer part, and the part from the decimal point on.
    assert value_columns(VALUES, len).width == 2 + 2 + 5 + 1 + 3 + len(".0625 rad")
    assert value_columns([b"  a longer line of words"], len).width == 24


def test_decimal_points_of_a_panel_are_aligned(setter) -> None:
    # Only the digit after the point differs; everything else, points included, has the same pixels.
    one = panel_of(setter, [b"A2  cmd   -12.5 Nm", b"    pos    3.0625 rad"])
    two = panel_of(setter, [b"A2  cmd   -12.8 Nm", b"    pos    3.0625 rad"])
    y, x = np.nonzero((one != two).any(axis=2))
    assert len(x) and y.max() < 38 and np.ptp(x) < setter.font.width("0")
    third = panel_of(setter, [b"A2  cmd   -12.5 Nm", b"    pos    3.8625 rad"])
    below_y, below_x = np.nonzero((one != third).any(axis=2))
    assert below_y.min() > 28
    assert abs(below_x.mean() - x.mean()) < 0.2 * setter.font.width("0")


def test_digits_have_one_width_and_numbers_do_not_move(setter) -> None:
    assert len({setter.font.width(figure) for figure in "0123456789"}) == 1
    narrow = panel_of(setter, [b"A1 111.1 Nm"])
    wide = panel_of(setter, [b"A1 888.8 Nm"])
    unit = slice(-10 - setter.font.width("Nm"), None)
    assert np.array_equal(narrow[:, unit], wide[:, unit])
    assert not np.array_equal(narrow, wide)


@pytest.mark.parametrize("line", [18, 28, 54])
def test_text_is_inside_its_panel_at_every_size(line: int) -> None:
    setter = Typesetter(line)
    lines = [b"gjpqy|  msr -888.8 Nm", b"        cmd -888.8888 rad/s2"]
    pad = round(0.35 * line)
    pixels = panel_of(setter, lines, 2.0 * pad)
    light = pixels[2:-2, 2:-2, :3].max(axis=2) > 60  # without the outline
    assert light.any() and not light[:, : pad - 4].any() and not light[:, -pad + 3 :].any()


def test_corners_are_round_and_colors_premultiplied(setter) -> None:
    pixels = setter.panel((80, 40), (0.5, 0.25, 0.0, 0.5), ())
    assert pixels[0, 0, 3] == 0 and pixels[20, 40].tolist() == [64, 32, 0, 128]
    assert len(np.unique(pixels[:8, :8, 3])) > 4  # antialiased
    assert (pixels[..., :3] <= pixels[..., 3:]).all()
    square = setter.panel((80, 40), (0.5, 0.25, 0.0, 0.5), (), is_round=False)
    assert (square == [64, 32, 0, 128]).all()


def test_panels_over_the_edge_of_an_image_are_clipped(setter) -> None:
    pixels = setter.panel((30, 20), (1.0, 0.0, 0.0, 1.0), (), is_round=False)
    for left, bottom, count in [(-10, -5, 300), (85, 50, 150), (200, 0, 0), (0, -30, 0)]:
        picture = np.zeros((60, 100, 3), np.uint8)
        compose(picture, [PlacedPanel(left, bottom, pixels)])
        assert (picture[..., 0] == 255).sum() == count
        assert not picture[..., 1:].any()


def test_half_transparent_panel_shows_half_of_the_image(setter) -> None:
    picture = np.full((50, 50, 3), 200, np.uint8)
    compose(
        picture, [PlacedPanel(0, 0, setter.panel((50, 50), (0, 0, 0, 0.5), (), is_round=False))]
    )
    assert (np.abs(picture.astype(int) - 100) <= 1).all()


def test_character_without_a_glyph_is_a_question_mark(setter) -> None:
    asked = setter.panel((60, 40), BLACK, (PlacedText(5, 5, "a?"),))
    assert np.array_equal(setter.panel((60, 40), BLACK, (PlacedText(5, 5, "a\ue000"),)), asked)
    assert not drawable("a\ue000") and drawable("a?")


@pytest.mark.parametrize("text", ["hüfte", "Łokieć", "колено", "γόνατο", "fuß 2"])
def test_letters_of_other_alphabets_are_drawn_and_measured(setter, text: str) -> None:
    assert drawable(text)
    widths = [setter.font.width(character) for character in text]
    assert min(widths) > 0 and abs(setter.font.width(text) - sum(widths)) <= len(text)
    lines = [text.encode(), b"ascii"]
    assert setter.font.line_widths(lines).tolist() == [*map(setter.font.width, lines)]
    plain = text.encode("ascii", "replace").decode()
    shown, asked = (
        setter.panel((160, 40), BLACK, (PlacedText(5, 5, each),)) for each in (text, plain)
    )
    assert not np.array_equal(shown, asked)


def test_lines_are_cut_between_characters() -> None:
    assert line_of("ü" * 60) == ("ü" * 49).encode()
    assert line_of("\ud800") == b"?"


def test_billboards_use_names_that_can_be_drawn() -> None:
    assert short_joint_names(["hüfte", "knie"], "bein") == ["hüfte", "knie"]
    assert short_joint_names(["a", "\ue000\ue001"], "bein") == ["a", "joint 2"]


def test_license_is_beside_the_typeface() -> None:
    folder = resources.files("sero_mj.viewer") / "fonts"
    assert "SIL Open Font License" in (folder / "OFL.txt").read_text()
    assert (
        sum(
            (folder / f"Inter-{w}.ttf").stat().st_size
            for w in ("Medium", "Medium-more", "SemiBold")
        )
        < 3e5
    )
