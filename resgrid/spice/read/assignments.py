"""Parser of parameter definitions ``name=value``, whose values may be expressions without quotes."""

from __future__ import annotations

import re
from itertools import pairwise

from resgrid.spice.read.cards import Card, Setting, Token, settings

_OPERATOR = re.compile(r"(?<=[^eE])[-+]|^[-+](?=\D)|[*/%^<>!&|?]|(?<=[eE])[-+](?!\d)")
_COMMA = re.compile(r"[}\'\")]*,")


def assignments(card: Card, tokens: list[Token], *, blanks: bool = False) -> list[Setting]:
    """Return the ``name=value`` pairs in `tokens`, which are tokens of the statement `card`.

    A value may be an expression without quotes, as far as the dialect allows that.  `blanks`: True if such an
    expression may contain blanks (after ``.param``); False if a blank ends a value (in an instance of a subcircuit).
    Raises CardError for tokens of another form.
    """
    if card.rules.instances:
        return settings(card, tokens)
    keys = [i for i, depth in enumerate(depths(tokens)) if depth == 0 and _begins_definition(tokens, i)]
    if tokens and (not keys or keys[0] > 0):
        raise card.error(tokens[0].offset, f"unexpected {tokens[0].text!r}; expected key=value")
    pairs: list[Setting] = []
    for begin, end in pairwise([*keys, len(tokens)]):
        key, parts = tokens[begin], tokens[begin + 2 : end]
        value = _value(card, parts, blanks=blanks, alone=len(keys) == 1)
        if value is None:
            raise card.error(key.offset, f"{key.text!r} has no value")
        pairs.append(Setting(key.text.lower(), key.offset, (value,)))
    return pairs


def depths(tokens: list[Token]) -> list[int]:
    """Return the nesting depth of parentheses before each token, one integer per token, 0 outside all parentheses."""
    depth, before = 0, []
    for token in tokens:
        before.append(depth)
        depth += token.is_mark("(") - token.is_mark(")")
    return before


def misplaced_comma(card: Card, pairs: list[Setting]) -> int | None:
    """Return the offset in the text of `card` of a comma between a value and the next name; None without such a comma.

    `pairs`: the definitions ``name=value`` of `card`, in its order.
    """
    for pair, after in pairwise(pairs):
        value = pair.values[-1]
        match = _COMMA.match(card.text, value.offset + len(value.text))
        if match is not None and match.end() <= after.offset:
            return match.end() - 1
    return None


def _begins_definition(tokens: list[Token], i: int) -> bool:
    """Return whether ``tokens[i]`` is a name before ``=``, and not an operand of ``==``, ``<=``, ``>=`` or ``!=``."""
    if (
        tokens[i].kind != "word"
        or tokens[i].text[-1] in "<>!"
        or i + 1 == len(tokens)
        or not tokens[i + 1].is_mark("=")
    ):
        return False
    doubled = i + 2 < len(tokens) and tokens[i + 2].is_mark("=") and tokens[i + 2].offset == tokens[i + 1].offset + 1
    return not doubled


def _value(card: Card, parts: list[Token], *, blanks: bool, alone: bool) -> Token | None:
    """Return the tokens of a value as one token; None if there is no value, or only a mark such as ``=``.

    `card`: the statement that contains the tokens; `parts`: the tokens from ``name=`` to the next definition; `blanks`:
    whether an expression without quotes may contain blanks; `alone`: whether the statement has only this definition.
    """
    if len(parts) == 3 and parts[0].is_mark("(") and parts[2].is_mark(")"):
        parts = parts[1:2]
    if len(parts) > 1:
        return _unquoted(card, parts, blanks=blanks, alone=alone)
    if not parts or parts[0].kind == "mark":
        return None
    is_expression = parts[0].kind == "word" and _OPERATOR.search(parts[0].text) is not None
    return _unquoted(card, parts, blanks=blanks, alone=alone) if is_expression else parts[0]


def _unquoted(card: Card, parts: list[Token], *, blanks: bool, alone: bool) -> Token:
    """Return an expression without quotes as one token; raise CardError where the dialect does not read it.

    `card`: the statement; `parts`: tokens of the expression; `blanks`: whether the expression may contain blanks;
    `alone`: whether the statement has only this definition, so that some dialects allow blanks.
    """
    begin, end = parts[0].offset, parts[-1].offset + len(parts[-1].text)
    text, form = card.text[begin:end], card.rules.words.loose
    quoted = any(token.kind in ("expression", "string") for token in parts)
    if not form or quoted:
        why = "is quoted only in part" if quoted else f"is not read without quotes in {card.rules.name}"
        raise card.error(begin, f"the expression {text!r} {why}: write all of it in braces or quotes")
    gap = _first_gap(card, parts, inside=not blanks)
    allowed = form == "any" or (form == "numeric" and alone and re.match(r"\+?\.?\d", text) is not None)
    if gap is not None and not (blanks and allowed):
        text = f"{card.rules.name} ends the value {text!r} here, or rejects it: write all of it in braces or quotes"
        raise card.error(gap, text)
    return Token("expression", text, begin)


def _first_gap(card: Card, parts: list[Token], *, inside: bool) -> int | None:
    """Return the offset in the text of `card` of the first token after a gap; None without a gap.

    A gap is a blank or comma between two tokens outside parentheses, and with `inside` also a blank within parentheses.
    `parts`: the tokens of a value.
    """
    for depth, token, after in zip(depths(parts)[1:], parts, parts[1:], strict=False):
        gap = card.text[token.offset + len(token.text) : after.offset]
        if gap and (depth == 0 or (inside and gap.strip(","))):
            return after.offset
    return None
