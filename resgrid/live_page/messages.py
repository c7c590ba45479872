"""Messages between page and server: binary messages with a JSON head and a body of bytes.

A message consists of ``uint32`` n (little endian), n bytes of JSON (padded with spaces to a multiple of 4), and a body.
The body of a drawing has one byte per cell in C order: the cell's code (`Cell`) plus 4 times the index of its
conductivity in the drawing's palette.
"""

from __future__ import annotations

import json
from typing import Annotated, Any, Literal

import numpy as np
from annotated_types import Ge, Gt, Le, Len
from pydantic import Field, Strict, ValidationError

from resgrid.core.axis import Axis
from resgrid.core.cell import Cell
from resgrid.errors import InputError
from resgrid.io.tables import json_text
from resgrid.live_page.drawing import Drawing, check_size
from resgrid.scene.table_models import TableModel

LARGEST = 8 << 20
"""Largest size of a message from the page, in bytes; a larger message closes the connection."""

_PAGE_WORDS = {
    "use --drive uniform": "choose the uniform drive",
    "--drive uniform": "the uniform drive",
    "boundary = 'neumann'": "k = 0",
}
"""Replacements in error messages: a text that names an option of the command line or a key of a scene, and the words
for the control of the page with the same effect.  The texts are replaced in this order.
"""

_Point = Annotated[tuple[float, ...], Strict(False), Len(2, 2)]


class AxisHead(TableModel):
    """An axis of a drawing in the JSON head of a message.

    `name`: name; `lower`, `upper`: limits in axis units; `cells`: number of cells; `periodic`: whether the ends are
    joined; `unit`: unit of the axis, empty for none.
    """

    name: Annotated[str, Len(1, 40)]
    lower: float
    upper: float
    cells: Annotated[int, Ge(1), Le(10**12)]
    periodic: bool = False
    unit: Annotated[str, Len(0, 40)] = ""


class DrawingHead(TableModel):
    """A drawing without its cells in the JSON head of a message: title, axes, and settings of the circuit.

    `edge`: boundary of each axis; `palette`: relative conductivities of cells; `starts`: points in axis units; `k`:
    weight of the Dirichlet field; `wall`: wall resistance in ohms, 0 for no wall; `leak`: leak to the obstacle rail, in
    1 / (unit of the axes)^2; `lattice`: name of the lattice; `driven`: whether the starts drive the circuit; `chip`:
    keys and values of the ``[chip]`` table; `world`: document of an arm's scene, None without an arm; `broken`: open
    resistors, as cell (i, j) and axis; `goal_points`: flat index of a goal cell and two coordinates of its goal.
    """

    title: Annotated[str, Len(0, 200)] = ""
    axes: Annotated[list[AxisHead], Len(2, 2)]
    edge: Annotated[list[Literal["obstacle", "open", "periodic"]], Len(2, 2)]
    palette: Annotated[list[Annotated[float, Gt(0)]], Len(1, 64)]
    starts: Annotated[list[_Point], Len(0, 50)]
    k: Annotated[float, Ge(0), Le(1)]
    wall: Annotated[float, Ge(0), Le(1e30)]
    leak: Annotated[float, Ge(0), Le(1e30)] = 0.0
    lattice: Literal["square", "square8", "hexagonal"] = "square"
    driven: bool
    chip: dict[str, Any] = Field(default_factory=dict)
    world: dict[str, Any] | None = None
    broken: Annotated[list[Annotated[tuple[int, int, int], Strict(False)]], Len(0, 1000)] = Field(default_factory=list)
    goal_points: list[Annotated[tuple[int, float, float], Strict(False)]] = Field(default_factory=list)


class File(TableModel):
    """A file that the user opens on the page.

    `name`: file name without a folder; `data`: content of the file, encoded in base64.
    """

    name: Annotated[str, Len(1, 200)]
    data: str


class Request(TableModel):
    """The JSON head of a request of the page; fields that a type of request does not need are None.

    `type`: kind of request: "solve" (a drawing), "settle" (transient), "paths" (paths in other fields), "save"
    (export), "probe" (properties of a cell), "world", "example", "files" or "link" (drawing of an arm's workspace, an
    example, files, a link); `seq`: number of the request, which the reply repeats; `drawing`: the drawing without its
    cells; `exact`: whether the solution must be direction-safe; `paths`: fields whose paths are compared; `format`:
    file format of an export; `cell`: index of a cell; `name`: name of an example; `files`: opened files; `document`:
    scene of a link (keys and tables).
    """

    type: Literal["solve", "paths", "save", "probe", "settle", "world", "example", "files", "link"]
    seq: Annotated[int, Ge(0)]
    drawing: DrawingHead | None = None
    exact: bool = True
    paths: Annotated[list[Literal["ideal", "k = 0", "k = 1"]], Len(1, 3)] | None = None
    format: Literal["toml", "json", "csv", "deck", "svg", "circuit"] | None = None
    cell: Annotated[list[int], Len(2, 2)] | None = None
    name: str | None = None
    files: Annotated[list[File], Len(1, 10)] | None = None
    document: dict[str, Any] | None = None


def read_request(message: bytes) -> tuple[Request, bytes]:
    """Return the JSON head and the body of a request; raise InputError if the message is invalid.

    `message`: the whole message.
    """
    size = int.from_bytes(message[:4], "little")
    if len(message) < 4 or size > len(message) - 4:
        raise InputError("this message is cut short; it must have a length, a JSON head and a body: reload the page")
    try:
        request = Request.model_validate(json.loads(message[4 : 4 + size]))
    except ValidationError as error:
        first = error.errors()[0]
        raise InputError(f"{'.'.join(map(str, first['loc'])) or 'request'}: {first['msg']}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"the head of this message is not JSON ({error}); reload the page") from None
    return request, message[4 + size :]


def read_drawing(head: DrawingHead | None, body: bytes) -> Drawing:
    """Return the drawing of a request; raise InputError if the drawing is missing or inconsistent.

    Goal configurations in cells that are not goal cells are dropped.  `head`: fields of the drawing, None if they are
    missing; `body`: one byte per cell, in C order: the cell's `Cell` code plus 4 times the index of its conductivity in
    `head.palette`.
    """
    if head is None:
        raise InputError("this request needs a drawing")
    shape = [axis.cells for axis in head.axes]
    check_size(shape)
    if len(body) != shape[0] * shape[1]:
        raise InputError(f"{shape[0]} x {shape[1]} cells need {shape[0] * shape[1]} bytes, got {len(body)}")
    cells = np.frombuffer(body, dtype=np.uint8).reshape(shape)
    code, level = cells & np.uint8(3), cells >> np.uint8(2)
    if code.max() > max(Cell) or level.max() >= len(head.palette):
        raise InputError("the code of a cell is not free, obstacle or goal, or its conductivity is not in the palette")
    for i, j, axis in head.broken:
        if axis not in (0, 1) or not (0 <= i < shape[0] + (axis == 0) and 0 <= j < shape[1] + (axis == 1)):
            raise InputError(f"there is no resistor at {[i, j]} across axis {axis}")
    keys = {
        key: value
        for key, value in head.model_dump().items()
        if key not in {"axes", "edge", "palette", "starts", "broken", "goal_points"}
    }
    return Drawing(
        axes=tuple(Axis(**axis.model_dump()) for axis in head.axes),
        edge=tuple(head.edge),
        cell=code,
        level=level,
        palette=tuple(head.palette),
        broken=tuple(head.broken),
        goal_points=tuple(
            row for row in head.goal_points if 0 <= row[0] < code.size and code.flat[row[0]] == Cell.GOAL
        ),
        starts=np.array(head.starts, dtype=np.float64).reshape(-1, 2),
        **keys,
    )


def write_drawing(drawing: Drawing) -> tuple[dict[str, Any], bytes]:
    """Return the JSON head and the body of a message with a drawing and its goal regions.

    The head has the keys ``drawing``, the fields of the drawing by name, and ``goals``, for each goal region the flat
    indices (C order) of its cells.  The body has one byte per cell in C order: the cell's `Cell` code plus 4 times the
    index of its conductivity in the field ``palette``.
    """
    space = drawing.space
    region, goals = space.goal_region.ravel(), []
    for number in range(space.goal_count):
        goals.append(np.flatnonzero(region == number).tolist())
    head = {
        "title": drawing.title,
        "axes": [{name: getattr(axis, name) for name in AxisHead.model_fields} for axis in drawing.axes],
        "edge": list(drawing.edge),
        "palette": list(drawing.palette),
        "starts": drawing.starts.tolist(),
        "k": drawing.k,
        "wall": drawing.wall,
        "leak": drawing.leak,
        "lattice": drawing.lattice,
        "driven": drawing.driven,
        "chip": dict(drawing.chip or {}),
        "broken": [list(place) for place in drawing.broken],
        "goal_points": [list(row) for row in drawing.goal_points],
        "world": None if drawing.world is None else dict(drawing.world),
    }
    return {"drawing": head, "goals": goals}, (drawing.cell | drawing.level << 2).tobytes()


def in_page_words(text: str) -> str:
    """Return an error message in which names of the page's controls replace options of the command line."""
    for option, words in _PAGE_WORDS.items():
        text = text.replace(option, words)
    return text


def pack(head: dict[str, Any], *body: bytes) -> bytes:
    """Return the bytes of a message with a JSON head and a body.

    `head`: values of the head by key, which are converted to JSON; `body`: parts of the body, which are concatenated.
    """
    text = json_text(head).encode()
    text += b" " * (-len(text) % 4)
    return b"".join((len(text).to_bytes(4, "little"), text, *body))
