"""Reserved names, constants, temperature and unquoted expressions in every dialect, compared with ngspice runs.

Tests internals: `resgrid.spice.dialects`, `resgrid.spice.run.ngspice`.
"""

from __future__ import annotations

import io
import math
import random
import re
from pathlib import Path

import pytest

import resgrid as rg
from resgrid.spice.dialects import DIALECTS
from resgrid.spice.run.ngspice import simulate

HEAD = "title\nV1 in 0 1\n"
TAIL = "\nR2 a 0 1k\n.op\n.end\n"


def read(text: str, dialect: str = "ngspice") -> rg.spice.Circuit:
    return rg.read_spice(io.StringIO(text), dialect=dialect)


def ohms(text: str, dialect: str) -> float:
    deck = read(text, dialect)
    return float(deck.resistance[[name.lower() for name in deck.element_names["resistor"]].index("r1")])


def ngspice_voltage(text: str) -> float | None:
    return simulate(text.encode(), direct=True).voltage.get("a")


def our_voltage(deck: rg.spice.Circuit) -> float:
    return float(rg.solve(deck).voltage[[name.lower() for name in deck.node_names].index("a")])


FOLLOWED = {
    "temperature by .temp": ".temp 127\nR1 in a r='500*(1+0.01*(temper-27))'",
    "temperature by .options": ".options temp=127\nR1 in a {500*(1+0.01*(temper-27))}",
    "temperature with a unit": ".options TEMP = 127°C\nR1 in a 500 tc1=0.01",
    "temperature with a suffix": ".options TEMP=.127k\nR1 in a 500 tc1=0.01",
    "temperature by an expression": ".options temp={100+27}\nR1 in a '500*(1+0.01*(TEMPER-27))'",
    "temperature in a parameter": ".temp 127\n.param q='temper-27' p='500*(1+0.01*q)'\nR1 in a {p}",
    "temperature in a subcircuit": ".temp 50\n.subckt s p q\nR1 p q '20*temper'\n.ends\nX1 in a s",
    "temperature in a function": ".temp 50\n.func f(x) {x*temper}\nR1 in a {f(20)}",
    "temperature and a coefficient": ".temp 50\nR1 in a '20*temper' tc1=0.01 tc2=1e-4 m=2",
    "temperature in a model": ".temp 50\n.model m r r='20*temper'\nR1 in a m",
    "an unused function name": ".param max=5\nR1 in a 1k",
    "a function of a built-in name": ".func max(x,y) {x+y}\nR1 in a {max(500,500)}",
    "an argument of a reserved name": ".func f(temper) {20*temper}\n.func g(max) {20*max}\nR1 in a 'f(25)+g(25)'",
    "constants are ordinary names": ".param pi=3 e=5 boltz=7 vt=2\nR1 in a {pi*e*boltz*vt}",
    "parentheses": ".param p = (500+500)\nR1 in a {p}",
    "a function without quotes": ".param p = sqrt(250000)\nR1 in a '2*p'",
    "a product": ".param p=2*(500)\nR1 in a {p}",
    "blanks": ".param p = 500 + 500\nR1 in a {p}",
    "blanks in parentheses": ".param p = max(1k, 500) q = 2*( 3 + 4 )\nR1 in a {p+q}",
    "a comparison": ".param b=1 p=(b==1)*1k\nR1 in a {p}",
    "unquoted in a call": ".subckt s p q r=2*(3)\nR1 p q {r}\n.ends\nX1 in a s r=2*(500)",
    "a function without arguments": ".func f() {1k}\n.func g() '1k'\nR1 in a {f()+g()}",
    "a function without braces": ".func f(x) x * 2\n.param g(x) = x*3\nR1 in a {f(200)+g(200)}",
    "three arguments": "R1 in a {max(1k,500,200)+min(1k,2k,3k)}",
    "an exponential coefficient": "R1 in a 1k tce=1 tc1=0.5\n.temp 37",
    "an exponential coefficient of a model": ".model m r(r=1k tce=-1)\nR1 in a m dtemp=10\n.options tnom=20",
    "resistance of a model": ".model m r(resistance=2k)\nR1 in a m",
    "names of KiCad 5": "R1 in Net-(R1-Pad2) 1k\nC1 Net-(R1-Pad2) 0 1u\nR3 Net-(R1-Pad2) a 1k",
    "names of KiCad 5 in a call": ".subckt s p q\nR1 p q 1k\n.ends\nX1 in Net-(R1-Pad2) s\nR3 Net-(R1-Pad2) a 1k",
    "a terminal called gnd": ".subckt s p gnd\nR1 p gnd 1k\n.ends\nX1 a 0 s\nX2 a gnd s\nR3 in a 1k",
    "other values of the line": ".subckt s p n W=1 nf=1 t=1\nR1 p n t\n.ends\nX1 in a s t='25*W/nf' W=80 nf=2",
    "a value of the subcircuit": ".subckt s p n t=1 W=7\nR1 p n t\n.ends\nX1 in a s t='25*W'",
    "the node null in a subcircuit": (
        ".subckt s p q\nR1 p null 1k\nR2 null q 100\n.ends\nX1 in 0 s\nX2 a 0 s\nR3 in a 1k"
    ),
    "a plain number in double quotes": 'R1 in a "1k" m="2"',
    "expressions in double quotes in a call": (
        '.param w=250\n.subckt s p q r="100*3" t=1\nR1 p q {r+t}\n.ends\nX1 in a s t="w*2"'
    ),
    "temper as part of a name": "R1 in n_temper 1k\nRtemper n_temper temper1 1k\nR3 temper1 a {100+temper}",
    "gnd inside nested subcircuits": (
        ".subckt t a b\nR1 a m 1k\nR2 m b 1k\n.ends\n.subckt u a b\nR1 a m 100\nR2 m b 100\n.ends\n"
        ".subckt w a b\nR1 a m 300\nR2 m b 300\n.ends\n"
        ".subckt s p q\nR1 q gnd 1k\nX1 p m t\nX2 m n9 u\nX4 n9 n10 u\nX3 n10 gnd w\nR3 p q 1k\n.ends\n"
        "R1 in a 1k\nX1 a b s\nR5 b 0 1k"
    ),
}


@pytest.mark.parametrize("name", FOLLOWED)
def test_voltages_of_decks_with_reserved_names_equal_those_of_ngspice(name: str) -> None:
    text = f"{HEAD}{FOLLOWED[name]}{TAIL}"
    measured = ngspice_voltage(text)
    assert measured is not None
    assert our_voltage(read(text)) == pytest.approx(measured, rel=1e-9)


REJECTED = {
    "temper as a parameter": (".param temper=50\nR1 in a r='20*temper'", "ngspice takes 'temper' for its temperature"),
    "a function name": (".param max=5\nR1 in a 'max*100'", "'max' is a function of ngspice"),
    "a function name, bare": (".param pow=5\nR1 in a pow", "'pow' is a function of ngspice"),
    "a function name of a call": (
        ".subckt s p q int=1\nR1 p q {100*int}\n.ends\nX1 in a s int=2",
        "rename the parameter",
    ),
    "an argument that is called": (".func f(max) {max(max,5)}\nR1 in a {f(1k)}", "also replaces the function max"),
    "the time": (".param time=5\nR1 in a {time}", "'time' is a reserved name of ngspice"),
    "the frequency, undefined": ("R1 in a {hertz}", "write a number"),
    "an undefined function name": ("R1 in a {5*max}", "write max(...)"),
    "a name with a point": (".param a.b=50\nR1 in a 1k", "'a.b' is not a valid parameter name in ngspice"),
    "a name with a dollar": (".param p$x=50\nR1 in a 1k", "'p$x' is not a valid parameter name"),
    "temper in a source": ("R1 in a 1k\nI1 0 a '1e-5*temper'", "does not know temper in I1"),
    "temper in a coefficient": ("R1 in a 500 tc1='temper/12700'", "does not know temper in tc1="),
    "temper in a call": (
        ".subckt s p q r=1\nR1 p q {r}\n.ends\nX1 in a s r='20*temper'",
        "does not know temper in r= of X1",
    ),
    "temper and int": ("R1 in a 'int(temper)'", "does not know int in an expression of temper"),
    "temper and a remainder": ("R1 in a 'temper%5'", "does not know % in an expression of temper"),
    "temper and scale": ("R1 in a '20*temper' scale=2", "drops scale="),
    "temper and tc": (".temp 50\nR1 in a '20*temper' tc=0.01", "drops tc="),
    "temper and dtemp": ("R1 in a '20*temper' dtemp=20 tc1=0.01", "drops dtemp="),
    "temper and temp": ("R1 in a '20*temper' temp=50 tc1=0.01", "drops temp="),
    "temper and a model": (".temp 50\n.model m r tc1=0.01\nR1 in a m r='20*temper'", "drops the model"),
    "temper and tc1": (".options tnom=20\nR1 in a '20*temper' tc1=0.01", "counts tc1= and tc2= from 27 degrees"),
    "temper and parentheses": ("R1 in Net-(R1-Pad2) '20*temper'\nR3 Net-(R1-Pad2) a 1k", "misreads the parentheses"),
    "temper without braces": ("R1 in a temper", "in braces only"),
    "blanks before another definition": (".param q=3 p = 500 + 500\nR1 in a {p}", "ends the value"),
    "blanks in a call": (".subckt s p q r=1\nR1 p q {r}\n.ends\nX1 in a s r=500 + 500", "ends the value"),
    "blanks behind a name": (".param a=2\n.param p = a * 500\nR1 in a {p}", "ends the value"),
    "a middle argument": ("R1 in a {min(3k,1k,2k)}", "compares the first and the last argument"),
    "a series resistance": ("L1 in a 1u rser=1k", "'rser' is not supported by the rules of ngspice"),
    "a terminal called gnd that is not": (".subckt s p gnd\nR1 p gnd 1k\n.ends\nX1 in a s", "is ground itself"),
    "a bare name and a second definition": (
        ".param q=1\n.param q=2\n.param p=1k\nR1 in a p",
        "ngspice may lose 'p' here, because q is defined twice",
    ),
    "a no-break space": ("R1\u00a0in a 1k", "U+00A0"),
    "gnd in an expression": (".param gnd=500\nR1 in a '10+abs(gnd)'", "'gnd' is a reserved name of ngspice (ground)"),
    "a model called gnd": (".model gnd r rsh=100\nR1 in a gnd l=10u w=2u", "misreads a model called 'gnd'"),
    "a subcircuit called gnd": (".subckt gnd p q\nR1 p q 1k\n.ends\nX1 in a gnd", "a subcircuit called 'gnd'"),
    "a model called r": (".model r r tc1=0.1\n.temp 50\nR1 in a 1k r", "misreads a model called 'r'"),
    "a model called time": (".model time r rsh=100\nR1 in a time l=10u w=2u", "misreads a model called 'time'"),
    "a node called temper": ("R1 in temper 1k\nR3 Temper a 1k", "misreads a node called 'temper'"),
    "a terminal called temper": (".subckt s p temper\nR1 p temper 1k\n.ends\nX1 in a s", "called 'temper'"),
    "a subcircuit called temper": (".subckt temper p q\nR1 p q 1k\n.ends\nX1 in a temper", "called 'temper'"),
    "a terminal called null": (".subckt s p null\nR1 p null 1k\n.ends\nX1 in a s", "null is a terminal of s"),
    "an expression in double quotes": ('R1 in a "300+200"', "misreads a value in double quotes: write it in braces"),
    "a parameter in double quotes": ('.param p="300+200"\nR1 in a {p}', "misreads a value in double quotes"),
    "a name in double quotes": ('.param p=500\nR1 in a r="p"', "misreads a value in double quotes"),
    "a function in double quotes": ('.func f(x) "x*2"\nR1 in a {f(250)}', "misreads a value in double quotes"),
    "a model's value in double quotes": ('.model m r r="300+200"\nR1 in a m', "misreads a value in double quotes"),
    "a source in double quotes": ('R1 in a 1k\nI1 0 a "1e-3+1e-3"', "misreads a value in double quotes"),
    "a parameter of .step": (".step param x 1 2 1\nR1 in a {x}", "'x' is defined only by .step (<text>:3)"),
}


@pytest.mark.parametrize("name", REJECTED)
def test_decks_that_ngspice_misreads_raise_input_error(name: str) -> None:
    lines, says = REJECTED[name]
    text = f"{HEAD}{lines}{TAIL}"
    with pytest.raises(rg.InputError, match=re.escape(says)):
        read(text)
    measured = ngspice_voltage(text.replace("\u00a0", " ") if name == "a no-break space" else text)
    assert measured is None or name in {
        "temper as a parameter",  # 20 times 27 degrees
        "a function name",  # 1 milliohm
        "a name with a point",  # the rest of the name is lost
        "a name with a dollar",
        "temper and scale",
        "temper and tc",
        "temper and dtemp",
        "temper and temp",
        "temper and tc1",
        "temper and a model",
        "blanks before another definition",  # 500
        "blanks in a call",
        "a middle argument",
        "a terminal called gnd that is not",
        "a bare name and a second definition",
        "a no-break space",
        "gnd in an expression",  # 10
        "a model called gnd",  # 1 milliohm
        "a model called r",  # its coefficient is lost
        "a terminal called null",
        "an expression in double quotes",  # 200
        "a parameter in double quotes",
        "a model's value in double quotes",
    }


def test_names_that_ngspice_misreads_are_rejected_in_long_decks(tmp_path: Path) -> None:
    filler = "".join(f"R{i} n{i} 0 1k\n" for i in range(9, 5000))
    path = tmp_path / "deck.cir"
    path.write_text(f"{HEAD}{filler}R1 in temper 1k{TAIL}")
    with pytest.raises(rg.InputError, match="misreads a node called 'temper'"):
        rg.read_spice(path)


def test_quoted_values_in_sequence_cause_no_note() -> None:
    assert not [note for note in read(f'{HEAD}R1 in a r="1k" m="2"{TAIL}').notes if note.outcome]


OTHERS = [
    ("ltspice", "R1 in a {100*pi}", 100 * math.pi),
    ("ltspice", ".temp 50\nR1 in a {20*temp}", 1000.0),
    ("ltspice", ".param p = 500 + 500 q=2*(3)\nR1 in a {p*q}", 6000.0),
    ("ltspice", ".param pi=3\nR1 in a 1k", "'pi' is a reserved name of LTspice"),
    ("ltspice", ".param temp=50\nR1 in a 1k", "'temp' is a reserved name of LTspice"),
    ("ltspice", ".param max=5\nR1 in a {max*2}", "'max' is a function of LTspice"),
    ("ltspice", ".func max(x) {x}\nR1 in a {max(1)}", "is a function of LTspice itself"),
    ("ltspice", "R1 in a 1k noiseless\n.savebias f\n.loadbias f", 1000.0),
    ("ltspice", "R1 in a {if(0.4,1,2)+if(-3,10,20)+if(0.6,100,200)+if(2>1,1k,2k)}", 1122.0),
    ("ltspice", "R1 in a {0.4 ? 1k : 2k}", "only values above 0.5 are true"),
    ("ltspice", "R1 in a {1k*(0.4 && 1)}", "only values above 0.5 are true"),
    ("xyce", "R1 in a {if(0.4,1,2)+(0.4 ? 10 : 20)}", 11.0),
    ("ltspice", ".param e=2 k=3\nR1 in a {e*k}", 6.0),
    ("xyce", "R1 in a {100*PI}", 100 * math.pi),
    ("xyce", ".options device temp=50\nR1 in a {10*TEMP+10*TEMPER+CtoK}", 1273.15),
    ("xyce", ".param max=5\nR1 in a {max*2}", 10.0),
    ("xyce", ".param gmin=5\nR1 in a 1k", "'gmin' is a reserved name of Xyce"),
    ("xyce", ".param vt=5\nR1 in a 1k", "'vt' is a reserved name of Xyce"),
    ("xyce", "R1 in a {vt}", "'vt' is a reserved name of Xyce"),
    ("xyce", ".param p=2*(500)\nR1 in a {p}", "is not read without quotes in xyce"),
    ("hspice", "R1 in a '20*temper'", 500.0),
    ("hspice", ".temp 50\n.param p=20*temper\nR1 in a p", 1000.0),
    ("hspice", ".param temper=50\nR1 in a 1k", "'temper' is a reserved name of HSPICE"),
    ("hspice", ".param pi=3\nR1 in a 'pi*2'", 6.0),
    ("hspice", ".param p=500 + 500\nR1 in a p", "hspice ends the value"),
    ("hspice", ".param abs=5\nR1 in a 'abs*2'", "'abs' is a function of HSPICE"),
]


@pytest.mark.parametrize(("dialect", "lines", "expected"), OTHERS)
def test_other_dialects_have_their_own_reserved_names(dialect: str, lines: str, expected: float | str) -> None:
    text = f"{HEAD}{lines}{TAIL}"
    if isinstance(expected, float):
        assert ohms(text, dialect) == pytest.approx(expected, rel=1e-15)
    else:
        with pytest.raises(rg.InputError, match=re.escape(expected)):
            read(text, dialect)


@pytest.mark.parametrize(
    ("lines", "expected"),
    [
        ("r1 (a 0) resistor r=100*M_PI", 100 * math.pi),
        ("o options temp=50 tnom=20\nr1 (a 0) resistor r=20*temp-tnom", 980.0),
        ("parameters p=(500 + 500) q=2\nr1 (a 0) resistor r=p*q", 2000.0),
        ("parameters temp=5\nr1 (a 0) resistor r=1", "'temp' is a reserved name of Spectre"),
        ("parameters M_PI=3\nr1 (a 0) resistor r=1", "'M_PI' is a reserved name of Spectre"),
        ("parameters export=3\nr1 (a 0) resistor r=1", "'export' is a reserved name of Spectre"),
        ("r1 (a 0) resistor r=m_pi", "'m_pi' is neither a number nor a known parameter"),
        ("r1 (a 0) resistor r=P_K", "'P_K' is a reserved name of Spectre"),
        ("parameters p=1 p=2\nr1 (a 0) resistor r=p", "the parameter p is defined twice"),
        ("parameters max=1\nr1 (a 0) resistor r=2*max", "'max' is a function of Spectre"),
    ],
)
def test_spectre_has_its_own_reserved_names(lines: str, expected: float | str) -> None:
    text = f"simulator lang=spectre\n{lines}\nv1 (a 0) vsource dc=1\n"
    if isinstance(expected, float):
        assert ohms(text, "spectre") == pytest.approx(expected, rel=1e-15)
    else:
        with pytest.raises(rg.InputError, match=re.escape(expected)):
            read(text, "spectre")


def test_utf_16_is_read_without_a_byte_order_mark(tmp_path: Path) -> None:
    text = f"{HEAD}R1 in a 1k{TAIL}"
    for coding in ("utf-16", "utf-16-le", "utf-16-be"):
        (tmp_path / "deck.net").write_bytes(text.encode(coding))
        deck = rg.read_spice(tmp_path / "deck.net", dialect="ltspice")
        assert our_voltage(deck) == 0.5 and not [note for note in deck.notes if note.outcome]
        assert [n.outcome for n in rg.read_spice(tmp_path / "deck.net").notes if "UTF-16" in n.text] == ["fails"]


def test_a_circular_temperature_raises_input_error() -> None:
    with pytest.raises(rg.InputError, match="is defined by 'temper' itself"):
        read(f"{HEAD}.options temp={{temper+1}}\nR1 in a {{temper}}{TAIL}")


_ORDINARY = ("p", "q", "w1", "Foo")
_PYTHON = {"max": max, "min": min, "sqrt": math.sqrt, "abs": abs}


def _expression(rng: random.Random, names: list[str], depth: int = 0) -> str:
    kind = rng.random()
    if depth > 2 or kind < 0.4:
        return rng.choice(names) if names and rng.random() < 0.7 else str(rng.randint(1, 60))
    if kind < 0.75:
        return f"({_expression(rng, names, depth + 1)}{rng.choice('+*/')}{_expression(rng, names, depth + 1)})"
    call = rng.choice(sorted(_PYTHON))
    first, second = (_expression(rng, names, depth + 1) for _ in range(2))
    return f"{call}({first},{second})" if call in ("max", "min") else f"{call}({first})"


def _case(rng: random.Random, dialect: str) -> tuple[str, float | None]:
    """A deck and the resistance of R1 by the manual; None if it defines a reserved name."""
    words = DIALECTS[dialect].reading.words
    celsius = rng.choice((DIALECTS[dialect].nominal_temperature, 50.0, 85.0))
    values: dict[str, float] = dict(words.constants) | dict.fromkeys(words.temperature, celsius)
    builtin = sorted(values)
    forbidden = sorted(
        words.undefinable | words.variables.keys() | words.temperature | (words.functions & {"max", "abs"})
    )
    rejected, lines = False, []
    for _ in range(rng.randint(1, 3)):
        name = rng.choice(forbidden if rng.random() < 0.2 else _ORDINARY)
        key = name.lower()
        if key in values and key in (word.lower() for word in _ORDINARY):
            continue
        rejected |= key in forbidden
        body = str(rng.randint(1, 50)) if rng.random() < 0.5 else _expression(rng, sorted(values))
        lines.append(f".param {name}={{{body}}}" if dialect != "hspice" else f".param {name}='{body}'")
        if key not in forbidden:
            values[key] = float(eval(body, {"__builtins__": {}}, {**_PYTHON, **values}))
    names = [name for name in values if name not in builtin or rng.random() < 0.5] + [
        name for name in forbidden if any(line.startswith(f".param {name}=") for line in lines)
    ]
    body = _expression(rng, names)
    expression = f"'{body}'" if dialect == "hspice" else f"{{{body}}}"
    text = f"{HEAD}" + "\n".join([*lines, f".temp {celsius}", f"R1 in a {expression}"]) + TAIL
    return text, None if rejected else float(eval(body, {"__builtins__": {}}, {**_PYTHON, **values}))


@pytest.mark.parametrize("dialect", ["ngspice", "ltspice", "xyce", "hspice"])
def test_random_reserved_names_have_the_manuals_value_or_are_rejected(dialect: str) -> None:
    rng = random.Random(1)
    outcomes = {"right": 0, "rejected": 0}
    for _ in range(50):
        text, expected = _case(rng, dialect)
        try:
            found = ohms(text, dialect)
        except rg.ResgridError:
            outcomes["rejected"] += 1
            assert expected is None, text
            continue
        if dialect == "ngspice":
            measured = ngspice_voltage(text)
            assert measured == pytest.approx(our_voltage(read(text)), rel=1e-9), text
        elif expected is None:  # a reserved name is defined but not used
            assert not DIALECTS[dialect].reading.words.undefinable & set(re.findall(r"\.param (\w+)=", text)), text
        else:
            assert found == pytest.approx(expected, rel=1e-12), text
        outcomes["right"] += 1
    assert min(outcomes.values()) > 3, outcomes


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ("R1 in a 1k ic=3", "ngspice has no ic= for R, and stops at it"),
        ("R1 in a 1k temp_ac=3", "ngspice has no temp_ac= for R"),
        ("R1 in a 1k\nC1 a 0 1p noisy=0", "ngspice has no noisy= for C"),
        ("R1 in a 1k\nV2 b 0 1 m=2\nR3 b 0 1k", "ngspice has no m= for V"),
    ],
)
def test_keys_that_stop_ngspice_are_noted(lines: str, says: str) -> None:
    text = f"{HEAD}{lines}{TAIL}"
    assert [note.outcome for note in read(text).notes if note.text.startswith(says)] == ["fails"]
    assert ngspice_voltage(text) is None
    assert not [note for note in read(text, "hspice").notes if note.outcome]


@pytest.mark.parametrize("comment", ["*#set temp=50", "  *# set temp=50"])
def test_commands_in_comments_of_ngspice_are_noted(comment: str) -> None:
    deck = read(f"{HEAD}R1 in a 1k tc1=0.01\n{comment}{TAIL}")
    assert [(note.line, note.outcome) for note in deck.notes if "*#" in note.text] == [(4, "unsure")]
    assert not [note for note in read(f"{HEAD}R1 in a 1k\n* # plain{TAIL}").notes if note.outcome]
