"""Syntax of Spectre that differs from SPICE: statements begin with keywords, elements are instances of masters.

A master is a primitive such as ``resistor``, a model or a subcircuit; its name follows the nodes of the instance.
"""

from __future__ import annotations

from resgrid.spice.dialects.record import ReadingRules
from resgrid.spice.read.cards import Card, Setting
from resgrid.spice.read.scopes import Block, Scope

PRIMITIVES = {
    "resistor": "r",
    "capacitor": "c",
    "inductor": "l",
    "vsource": "v",
    "isource": "i",
    "bsource": "b",
    "iprobe": "v",
}
"""Letter of the equivalent SPICE element, by the name of a Spectre primitive; other primitives cannot be read."""

STATEMENTS = {
    "subckt": ".subckt",
    "ends": ".ends",
    "parameters": ".param",
    "global": ".global",
    "model": ".model",
    "include": ".include",
    "ic": ".ic",
    "nodeset": ".nodeset",
    "save": ".save",
    "print": ".print",
    "plot": ".plot",
    "protect": ".protect",
    "unprotect": ".unprotect",
    "statistics": ".mc",
}
"""Equivalent dot command of SPICE by the keyword of a Spectre statement."""

_ANALYSES = (
    "dc ac tran noise xf sp stb sens pz hb pss pac pnoise pxf psp pstb qpss qpac qpnoise envlp dcmatch info check "
    "checklimit set shell"
)
_MASTERS = {
    "options": ".options",
    **dict.fromkeys(_ANALYSES.split(), ".op"),
    **dict.fromkeys(("sweep", "montecarlo", "alter", "altergroup"), ".step"),
}
_REFUSED = frozenset(
    "ahdl_include else endsection export function if inline library local paramset real section veriloga".split()  # noqa: SIM905
)
_WAVEFORMS = frozenset(
    "wave file val0 val1 period delay rise fall width sinedc ampl freq sinephase edgetype td1 tau1 td2 tau2".split()  # noqa: SIM905
)
_SMALL_SIGNAL = frozenset(("mag", "phase", "pacmag", "pacphase", "xfmag", "isnoisy"))


_WORDS = {dot: word for word, dot in STATEMENTS.items()} | {".option": "options", ".temp": "options temp"}


def word_for(rules: ReadingRules, dot: str) -> str:
    """Return the dialect's keyword for a dot command of SPICE, such as ``subckt`` for ``.subckt`` in Spectre."""
    return _WORDS.get(dot, dot) if rules.instances else dot


def words_of(card: Card) -> list[str]:
    """Return the words of a Spectre card that precede the first ``key=``, without parentheses."""
    head, keyed, _ = card.text.partition("=")
    words = head.replace("(", " ").replace(")", " ").split()
    return words[:-1] if keyed else words


def statement_of(card: Card) -> str:
    """Return the dot command of SPICE that is equivalent to a Spectre statement, an empty string for an instance.

    Raises CardError for a statement that is not supported.
    """
    words = words_of(card) or [card.text.split()[0]]
    if words[0] in _REFUSED:
        raise card.error(0, f"the statement {words[0]} is not supported; replace it by the elements that it defines")
    return STATEMENTS.get(words[0]) or (_MASTERS.get(words[-1], "") if len(words) > 1 else "")


def command_of(card: Card, dot: str) -> str:
    """Return the name of a card's command as the card writes it: in Spectre the keyword or the master, else `dot`.

    `dot`: the equivalent dot command of SPICE.  The master of a Spectre statement is the last word before its
    parameters, such as the kind of an analysis.
    """
    words = words_of(card)
    if not card.rules.instances or not words:
        return dot
    return words[0] if words[0] in STATEMENTS else words[-1]


def letter_of(card: Card, block: Block) -> str:
    """Return the letter of the SPICE element that is equivalent to a Spectre instance, "x" for a subcircuit.

    The kind of the instance may be the name of a model.  `card`: the instance; `block`: the deck or subcircuit that
    contains the card, and perhaps the model.  Raises CardError for a model of a kind that cannot be read.
    """
    master = (words_of(card) or [""])[-1]
    model = block.model(master.lower())
    if model is not None and model.kind not in PRIMITIVES:
        raise card.error(0, f"{master} is a model of kind {model.kind!r}; only {', '.join(PRIMITIVES)} can be read")
    return PRIMITIVES.get(master if model is None else model.kind, "x")


def source_value(card: Card, pairs: list[Setting], scope: Scope) -> tuple[float, float]:
    """Return the value of a source at direct current, in volts or amperes, and the number of parallel sources.

    `card`: the card of the source; `pairs`: its ``key=value`` pairs; `scope`: parameter values.
    """
    values: dict[str, float] = {}
    waveform = False
    for pair in pairs:
        if pair.key in ("dc", "m"):
            values[pair.key] = scope.number(card, pair.values[0])
        elif pair.key in _WAVEFORMS or (pair.key == "type" and pair.values[0].text != "dc"):
            waveform = True
        elif pair.key != "type" and pair.key not in _SMALL_SIGNAL:
            raise card.error(pair.offset, f"{pair.key!r} is not supported in a source at direct current")
    if waveform and "dc" not in values:
        raise card.error(None, "a source with a waveform only: add its value at direct current, dc=...")
    return values.get("dc", 0.0), values.get("m", 1.0)
