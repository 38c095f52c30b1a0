"""The kinds of messages from browsers, with the types and bounds of the fields.

Only `MessageReader` parses messages. A new kind needs a class here, a place in `ForScene` or
`ForStartPage`, and a handler in the page. Messages other than `Got` and `Control` are ignored
unless they come from the browser in control, see `Browsers`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

MAX_BYTES = 2**15  # size of a message; only a view in a link exceeds about 100 bytes
MAX_PIXELS = 20_000  # width and height of a page
_MAX_LENGTH = 1e6  # m
_MAX_DEGREES = 1e6
_MAX_COUNT = 2**31
_MAX_NUMBER = 1e300


class PageMessage(BaseModel):
    """Base class of all messages; unknown fields and wrong types are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


_Pixels = Annotated[int, Field(gt=0, lt=MAX_PIXELS)]
_Pixel = Annotated[float, Field(gt=-MAX_PIXELS, lt=MAX_PIXELS)]
_Meters = Annotated[float, Field(gt=-_MAX_LENGTH, lt=_MAX_LENGTH)]
_Degrees = Annotated[float, Field(gt=-_MAX_DEGREES, lt=_MAX_DEGREES)]
_Index = Annotated[int, Field(ge=0, lt=_MAX_COUNT)]
_Name = Annotated[str, Field(max_length=300)]
_Path = Annotated[str, Field(max_length=4096)]
_Id = Annotated[str, Field(max_length=2000)]  # identifier of a widget: label and scopes


class Got(PageMessage):
    """The browser has received a state."""

    t: Literal["got"]


class Control(PageMessage):
    """The user takes control of the page."""

    t: Literal["control"]


class PageSize(PageMessage):
    """Size of the image and width of the page, pixels."""

    t: Literal["size"]
    w: _Pixels
    h: _Pixels
    page: _Pixels


class CameraMessage(PageMessage):
    """The camera; `fixed` is the index of a scene camera, or -1 for a free camera."""

    t: Literal["camera"]
    fixed: Annotated[int, Field(ge=-1, lt=_MAX_COUNT)]
    lookAt: tuple[_Meters, _Meters, _Meters]
    distance: Annotated[float, Field(ge=1e-6, lt=_MAX_LENGTH)]
    azimuth: _Degrees
    elevation: _Degrees


class PointerMessage(PageMessage):
    """An event of the pointer at a pixel, from the upper left corner of the image."""

    t: Literal["pointer"]
    kind: Literal["press", "release", "move", "leave"]
    x: _Pixel
    y: _Pixel
    button: Literal[0, 1, 2] = 0
    shift: bool = False
    ctrl: bool = False


class Wheel(PageMessage):
    """A rotation of the wheel, in notches away from the user."""

    t: Literal["wheel"]
    n: _Pixel


class HoldMessage(PageMessage):
    """The user holds a finger still on the screen."""

    t: Literal["hold"]


class KeyMessage(PageMessage):
    """The user has pressed a key or a combination of keys."""

    t: Literal["key"]
    key: Annotated[str, Field(max_length=40)]
    repeat: bool = False


class Card(PageMessage):
    """A click on a text over the image: kind and index of its item, and the pixel of the pointer.

    With the keyboard, the pixel is the center of the text.
    """

    t: Literal["card"]
    kind: _Index
    item: _Index
    x: _Pixel
    y: _Pixel
    shift: bool = False


class Widget(PageMessage):
    """The user has changed or pressed a widget of a panel."""

    t: Literal["widget"]
    tree: _Name
    id: _Id
    value: (
        bool
        | Annotated[int, Field(gt=-_MAX_COUNT, lt=_MAX_COUNT)]
        | Annotated[float, Field(gt=-_MAX_NUMBER, lt=_MAX_NUMBER)]
        | Annotated[str, Field(max_length=1000)]
    )


class Fold(PageMessage):
    """The user opens or closes a section of a panel."""

    t: Literal["fold"]
    tree: _Name
    id: _Id
    open: bool


class CloseArea(PageMessage):
    """The user closes an area beside the image."""

    t: Literal["close"]
    area: _Name


class ViewMessage(PageMessage):
    """A view from a link, see `ViewState.from_text`."""

    t: Literal["view"]
    text: Annotated[str, Field(max_length=20_000)]


class OpenTile(PageMessage):
    """The user opens a tile of the start page."""

    t: Literal["tile"]
    number: _Index


class OpenShown(PageMessage):
    """The user opens a scene that shows received packets."""

    t: Literal["shown"]
    scene: _Path


# Only these kinds are accepted from browsers without control.
ForAll = Got | Control
ForScene = (
    ForAll
    | PageSize
    | CameraMessage
    | PointerMessage
    | Wheel
    | HoldMessage
    | KeyMessage
    | Card
    | Widget
    | Fold
    | CloseArea
    | ViewMessage
)
ForStartPage = ForAll | OpenTile | OpenShown


class Left(NamedTuple):
    """The browser in control has disconnected or lost control. The server creates this message."""


class MessageSender(NamedTuple):
    """The browser that has sent a message.

    Attributes:
        id: number of its connection.
        is_local: whether the connection comes from this machine, see `guard.is_local`.
    """

    id: int
    is_local: bool


class Received(NamedTuple):
    """A message with its sender."""

    message: PageMessage | Left
    sender: MessageSender


class MessageReader:
    """Parses the messages of `ForScene` or `ForStartPage`."""

    def __init__(self, kinds: Any) -> None:
        self.kinds: tuple[type[PageMessage], ...] = get_args(kinds)
        found: Any = Annotated[kinds, Field(discriminator="t")]
        self._adapter: TypeAdapter[PageMessage] = TypeAdapter(found)

    def read(self, message: str | bytes) -> PageMessage | None:
        # The parser limits nesting. Longer messages are not parsed.
        if not isinstance(message, str) or len(message) > MAX_BYTES:
            return None
        try:
            return self._adapter.validate_json(message)
        except (ValidationError, UnicodeEncodeError):
            return None
