"""Gerber, drill and IPC-D-356 files: geometry, connection through holes, and rejected commands.

Tests internals: `resgrid.hardware.copper`, `resgrid.hardware.excellon`, `resgrid.hardware.gerber`,
`resgrid.hardware.ipc_d356`.
"""

from __future__ import annotations

import math

import pytest

import resgrid as rg
from resgrid.hardware.copper import connect_copper
from resgrid.hardware.excellon import Hole, parse_excellon
from resgrid.hardware.gerber import parse_gerber
from resgrid.hardware.ipc_d356 import TestPoint, parse_ipc_d356

HEAD = "%TF.FileFunction,Copper,L1,Top*%\n%FSLAX46Y46*%\n%MOMM*%\n%LPD*%\nG01*\n"
MACRO = """%AMRoundRect*
0 Rectangle with rounded corners*
4,1,4,$2,$3,$4,$5,$6,$7,$8,$9,$2,$3,0*
1,1,$1+$1,$2,$3*
1,1,$1x2,$4,$5*
1,1,$1+$1,$6,$7*
1,1,$1+$1,$8,$9*
20,1,$1+$1,$2,$3,$4,$5,0*
20,1,$1+$1,$4,$5,$6,$7,0*
20,1,$1+$1,$6,$7,$8,$9,0*
20,1,$1+$1,$8,$9,$2,$3,0*%
%ADD10RoundRect,0.25X-0.75X-0.25X0.75X-0.25X0.75X0.25X-0.75X0.25X0*%
"""
SQUARE = "G36*X0Y0D02*X2000000D01*Y2000000D01*X0D01*Y0D01*G37*"


def gerber(body: str) -> str:
    return f"{HEAD}{body}\nM02*\n"


@pytest.mark.parametrize(
    ("body", "area"),
    [
        ("%ADD10C,2.0*%D10*X0Y0D03*", math.pi),
        ("%ADD10C,2.0X1.0*%D10*X0Y0D03*", math.pi * 0.75),
        ("%ADD10R,2.0X1.0*%D10*X0Y0D03*", 2.0),
        ("%ADD10O,3.0X1.0*%D10*X0Y0D03*", 2.0 + math.pi / 4),
        ("%ADD10P,2.0X4X45*%D10*X0Y0D03*", 2.0),
        ("%ADD10C,1.0*%D10*X0Y0D02*X4000000Y0D01*", 4.0 + math.pi / 4),
        ("%ADD10C,1.0*%D10*X0Y0D02*X0Y0D01*", math.pi / 4),
        (f"{MACRO}D10*X5000000Y0D03*", 2.0 * 1.0 - (4 - math.pi) * 0.25**2),
        ("%AMBox*21,1,$1,$2,0,0,45*%%ADD10Box,2X1*%D10*X0Y0D03*", 2.0),
        ("%AMHex*5,1,6,0,0,2,30*%%ADD10Hex,0*%D10*X0Y0D03*", 1.5 * math.sqrt(3)),
        (SQUARE, 4.0),
        (f"{SQUARE}%LPC*%%ADD10C,1.0*%D10*X1000000Y1000000D03*", 4.0 - math.pi / 4),
        ("G75*G36*X1000000Y0D02*G03*X1000000Y0I-1000000J0D01*G01*G37*", math.pi),
        ("G75*G36*X1000000Y0D02*G02*X-1000000Y0I-1000000J0D01*G01*X1000000D01*G37*", math.pi / 2),
    ],
)  # fmt: skip
def test_objects_have_their_area(body: str, area: float) -> None:
    assert sum(shape.geometry.area for shape in parse_gerber(gerber(body))) == pytest.approx(area, rel=3e-3)


def test_a_region_with_seams_has_holes() -> None:
    """An area with a hole is written as one contour that runs along a seam twice."""
    body = (
        "G36*X0Y0D02*X9000000D01*Y9000000D01*X0D01*Y0D01*X3000000Y3000000D01*Y6000000D01*X6000000D01*Y3000000D01*"
        "X3000000D01*X0Y0D01*G37*"
    )
    (shape,) = parse_gerber(gerber(body))
    assert shape.geometry.area == pytest.approx(72.0) and len(shape.geometry.interiors) == 1


def test_inches_and_nets_are_read() -> None:
    text = "%FSLAX24Y24*%\n%MOIN*%\n%ADD10C,0.1*%\nD10*\n%TO.N,n\\u005f1*%\nX10000Y0D03*\n%TD*%\nX20000Y0D03*\nM02*\n"
    first, second = parse_gerber(text)
    assert first.geometry.centroid.x == pytest.approx(25.4) and first.geometry.bounds[3] == pytest.approx(1.27)
    assert (first.net, second.net) == ("n_1", "")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (HEAD, "M02 at the end is missing"),
        (gerber("D10*X0Y0D03*"), "aperture D10 is used, but not defined"),
        (gerber("X0Y0D03*"), "an object has no aperture"),
        (gerber("%ADD10R,1X1*%D10*X0Y0D02*X1Y0D01*"), "not a circle"),
        (gerber("%SRX2Y2I1J1*%"), "'SRX2Y2I1J1' is not supported"),
        (gerber("%ADD10Other,1*%"), "'Other' is neither standard nor a macro"),
        (gerber("%AMT*7,0,0,1,0.5,0.1,0*%%ADD10T,1*%"), "primitive 7 is not supported"),
        (gerber("%AMT*1,1,__import__('os')*%%ADD10T,1*%"), "D10 is damaged"),
        (gerber("G91*"), "'G91' is not supported"),
    ],
)
def test_unsupported_gerber_commands_are_named(text: str, words: str) -> None:
    with pytest.raises(rg.InputError, match=r"layer\.gtl") as caught:
        parse_gerber(text, "layer.gtl")
    assert words in str(caught.value)


DRILL = """M48
; DRILL file
FMAT,2
METRIC
T1C0.400
T2C1.000
%
G90
G05
T1
X1.0Y-2.5
X3.0
T2
X4.0Y0.0G85X6.0Y0.0
M30
"""


def test_holes_and_slots_are_read() -> None:
    assert parse_excellon(DRILL) == [
        Hole((1.0, -2.5), (1.0, -2.5), 0.4),
        Hole((3.0, -2.5), (3.0, -2.5), 0.4),
        Hole((4.0, 0.0), (6.0, 0.0), 1.0),
    ]
    assert parse_excellon(DRILL.replace("METRIC", "INCH"))[0].diameter == pytest.approx(10.16)


@pytest.mark.parametrize(("old", "new"), [("M30\n", ""), ("X3.0\n", "G00X3.0\n"), ("T2\n", "T3\n")])
def test_damaged_drill_files_are_rejected(old: str, new: str) -> None:
    with pytest.raises(rg.InputError, match=r"holes\.drl.*(missing|not supported)"):
        parse_excellon(DRILL.replace(old, new, 1), "holes.drl")


FRONT = gerber(
    "%ADD10C,1.0*%%ADD11C,0.2*%D10*%TO.N,a*%X0Y0D03*%TO.N,b*%X5000000Y0D03*D11*%TO.N,a*%X0Y0D02*X2000000Y0D01*%TO.N,b*%X3000000Y0D02*X5000000Y0D01*"
)
BACK = gerber("%ADD11C,0.2*%D11*X2000000Y0D02*X3000000Y0D01*")


@pytest.mark.parametrize(
    ("plated", "unplated", "connected"),
    [
        ([], [], False),
        ([2.0, 3.0], [], True),
        ([2.0], [3.0], False),
        ([2.0, 3.0], [2.5], False),
        ([2.0, 3.0], [1.0], False),
    ],
)
def test_only_copper_and_plated_holes_connect(plated: list[float], unplated: list[float], connected: bool) -> None:
    """Two pads on the front are connected by a track on the back and two vias, unless a hole cuts a track."""
    holes = [[Hole((x, 0.0), (x, 0.0), 0.4) for x in places] for places in (plated, unplated)]
    copper = connect_copper([parse_gerber(FRONT), parse_gerber(BACK)], *holes)
    assert (copper.probe((0.0, 0.0), 1) == copper.probe((5.0, 0.0), 1)) == connected
    assert copper.probe((0.0, 0.0), 2) is None and copper.probe((0.0, 0.3), 0) is not None


def test_touching_copper_of_two_nets_is_located() -> None:
    bridge = FRONT.replace("M02*", "%TO.N,a*%X2000000Y0D02*X3100000Y0D01*M02*")
    (contact,) = connect_copper([parse_gerber(bridge)], [], []).contacts
    assert contact.nets == ("a", "b") and contact.layer == 1
    assert contact.position[0] == pytest.approx(3.05, abs=0.2) and "mm on copper layer 1" in str(contact)


TESTER = """P  CODE 00
P  UNITS CUST 0
P  NNAME1 a_long_name_of_a_net
317OBSTACLE         VIA        MD0157PA00X+013811Y-015811X0315Y0000R000S3
327N_0_0            R1    -1          A01X+012486Y-017811X0315Y0374R270S2
317NNAME1           J1    -2    D0394UA00X+009843Y-011811X0669Y0000R000S0
999
"""


def test_test_points_are_read() -> None:
    via, pad, pin = parse_ipc_d356(TESTER)
    assert (via.reference, via.pin, via.plated, via.hole) == ("VIA", "", True, pytest.approx(0.39878))
    assert pad == TestPoint("N_0_0", "R1", "1", (12486 * 2.54e-3, -17811 * 2.54e-3), 1, None, False)
    assert (pin.net, pin.pin, pin.plated, pin.access) == ("a_long_name_of_a_net", "2", False, 0)
    assert parse_ipc_d356(TESTER.replace("CUST 0", "SI"))[1].position[0] == pytest.approx(12.486)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("999\n", "", "record 999 at the end is missing"),
        ("CUST 0", "CUST 7", "line 2: units 'CUST 7' are unknown"),
        ("X+012486", "X+01248a", "line 5: '+01248a' is not a number"),
        ("A01X", "A01Z", "line 5: column 42 holds 'Z' instead of X"),
    ],
)
def test_damaged_test_files_are_rejected(old: str, new: str, words: str) -> None:
    with pytest.raises(rg.InputError, match=r"grid\.d356") as caught:
        parse_ipc_d356(TESTER.replace(old, new), "grid.d356")
    assert words in str(caught.value)
