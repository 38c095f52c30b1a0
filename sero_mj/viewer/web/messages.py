"""The kinds of messages from browsers, with types and limits of their fields.

Only `MessageReader` parses messages. A new kind needs a class here, an entry in `ForScene` or
`ForStartPage`, and a handler in the page. Browsers without control can only send `Got` and
`Control`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, NamedTuple, get_args

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

MAX_BYTES = 2**15  # maximum size of a message; only a view in a link exceeds about 100 bytes
MAX_PIXELS = 20_000  # maximum width and height of a page
_MAX_LENGTH = 1e6  # m
_MAX_DEGREES = 1e6
_MAX_COUNT = 2**31
_MAX_NUMBER = 1e300


class PageMessage(BaseModel):
    """Base class of all messages. Unknown fields and wrong types are errors."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


_Pixels = Annotated[int, Field(gt=0, lt=MAX_PIXELS)]
_Pixel = Annotated[float, Field(gt=-MAX_PIXELS, lt=MAX_PIXELS)]
_Meters = Annotated[float, Field(gt=-_MAX_LENGTH, lt=_MAX_LENGTH)]
_Degrees = Annotated[float, Field(gt=-_MAX_DEGREES, lt=_MAX_DEGREES)]
_Index = Annotated[int, Field(ge=0, lt=_MAX_COUNT)]
_Name = Annotated[str, Field(max_length=300)]
_Path = Annotated[str, Field(max_length=4096)]
_Id = Annotated[str, Field(max_length=2000)]  # identifier of a widget, from scopes and label


class Got(PageMessage):
    """Message sent when the browser has received a state."""

    t: Literal["got"]


class Control(PageMessage):
    """Message sent when the user takes control of the page."""

    t: Literal["control"]


class PageSize(PageMessage):
    """Message with the width and height of the image, and the width of the page, in pixels."""

    t: Literal["size"]
    w: _Pixels
    h: _Pixels
    page: _Pixels


class CameraMessage(PageMessage):
    """Message with the camera. `fixed` is the index of a scene camera, or -1 for a free camera."""

    t: Literal["camera"]
    fixed: Annotated[int, Field(ge=-1, lt=_MAX_COUNT)]
    lookAt: tuple[_Meters, _Meters, _Meters]
    distance: Annotated[float, Field(ge=1e-6, lt=_MAX_LENGTH)]
    azimuth: _Degrees
    elevation: _Degrees


class PointerMessage(PageMessage):
    """Message about a pointer event. The upper left corner of the image is the pixel (0, 0)."""

    t: Literal["pointer"]
    kind: Literal["press", "release", "move", "leave"]
    x: _Pixel
    y: _Pixel
    button: Literal[0, 1, 2] = 0
    shift: bool = False
    ctrl: bool = False


class Wheel(PageMessage):
    """Message about the mouse wheel. `n` is the number of notches away from the user."""

    t: Literal["wheel"]
    n: _Pixel


class HoldMessage(PageMessage):
    """Message sent when the user holds a finger still on the screen."""

    t: Literal["hold"]


class KeyMessage(PageMessage):
    """Message sent when the user has pressed a key or a combination of keys."""

    t: Literal["key"]
    key: Annotated[str, Field(max_length=40)]
    repeat: bool = False


class TextClick(PageMessage):
    """Message about a click on a text over the image, with the kind and index of its item.

    The pixel is the position of the pointer. For the keyboard, it is the center of the text.
    """

    t: Literal["card"]
    kind: _Index
    item: _Index
    x: _Pixel
    y: _Pixel
    shift: bool = False


class Widget(PageMessage):
    """Message sent when the user has changed or pressed a widget of a panel."""

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
    """Message sent when the user opens or closes a section of a panel."""

    t: Literal["fold"]
    tree: _Name
    id: _Id
    open: bool


class CloseArea(PageMessage):
    """Message sent when the user closes an area beside the image."""

    t: Literal["close"]
    area: _Name


class ViewMessage(PageMessage):
    """Message with a view that a link contains, in the format of `ViewState`."""

    t: Literal["view"]
    text: Annotated[str, Field(max_length=20_000)]


class OpenTile(PageMessage):
    """Message sent when the user opens a tile of the start page."""

    t: Literal["tile"]
    number: _Index


class OpenShown(PageMessage):
    """Message sent when the user opens a scene for packets that are received already."""

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
    | TextClick
    | Widget
    | Fold
    | CloseArea
    | ViewMessage
)
ForStartPage = ForAll | OpenTile | OpenShown


class Left(NamedTuple):
    """Message of the server: the browser in control has disconnected or lost control."""


class MessageSender(NamedTuple):
    """The browser that has sent a message.

    Attributes:
        id: number of the browser's connection.
        is_local: whether the connection comes from this machine, see `guard.is_local`.
    """

    id: int
    is_local: bool


class Received(NamedTuple):
    """A message of a browser, and its sender."""

    message: PageMessage | Left
    sender: MessageSender


class MessageReader:
    """Parses messages of browsers. `kinds` is `ForScene` or `ForStartPage`."""

    def __init__(self, kinds: Any) -> None:
        self.kinds: tuple[type[PageMessage], ...] = get_args(kinds)
        found: Any = Annotated[kinds, Field(discriminator="t")]
        self._adapter: TypeAdapter[PageMessage] = TypeAdapter(found)

    def read(self, message: str | bytes) -> PageMessage | None:
        # The parser limits the nesting.
        if not isinstance(message, str) or len(message) > MAX_BYTES:
            return None
        try:
            return self._adapter.validate_json(message)
        except (ValidationError, UnicodeEncodeError):
            return None
