"""Values that resistors and switches get from ``.model`` cards (statements that define named parameter sets).

ngspice manual, section 3.3.2 (semiconductor resistor): ``R = RSH (L - 2 SHORT) / (W - 2 NARROW)``, with ``L`` and ``W``
of 10 micrometres by default; SPICE3 and Xyce subtract the reductions once.  Section 3.2.14 (switches).
"""

from __future__ import annotations

import math

from resgrid.spice.read.cards import Card
from resgrid.spice.read.scopes import Model, Scope
from resgrid.spice.read.temperature import refuse_unsupported

RESISTOR_KINDS = frozenset({"r", "res", "resistor"})
SWITCH_KINDS = frozenset({"sw", "vswitch"})

_DEFAULT_LENGTH = 10e-6
"""Length, and width, in metres, of a resistor for which neither its card nor its model states them."""

_ALIASES = {
    "res": "r",
    "tc1r": "tc1",
    "tc2r": "tc2",
    "tref": "tnom",
    "dw": "narrow",
    "dlr": "short",
    "dl": "short",
    "defl": "l",
    "defw": "w",
}
_RESISTOR_KEYS = frozenset({"r", "tc1", "tc2", "tnom", "rsh", "l", "w", "narrow", "short"})
_IGNORED_KEYS = frozenset({"level", "kf", "af", "ef", "lf", "wf", "noise", "bv_max", "version"})
_SWITCH_KEYS = frozenset({"ron", "roff", "vt", "vh", "von", "voff"})


def model_values(model: Model, scope: Scope, known: frozenset[str]) -> dict[str, float]:
    """Return the values of a model's keys, by key in lower case; raise CardError for an unknown or repeated key.

    Alternative names of a key are replaced by the usual one; keys without effect on resistances are left out.  `model`:
    the model; `scope`: parameter values of the deck or subcircuit with the element that uses the model; `known`: the
    keys that the model may have.
    """
    values: dict[str, float] = {}
    home, rules = scope.scope_of(model.block), model.card.rules
    for setting in model.settings:
        own = rules.ignored_model_keys.get(setting.key)
        if own == "":
            raise model.card.error(setting.offset, f"{setting.key} of a model is not read; write the resistance, r")
        if own is not None:
            raise model.card.error(setting.offset, f"{rules.name} ignores {setting.key}; write {own}, or leave it out")
        key = rules.words.model_aliases.get(setting.key, _ALIASES.get(setting.key, setting.key))
        if key in _IGNORED_KEYS:
            continue
        if key not in known:
            text = f"{setting.key} is not a known parameter of a model of kind {model.kind}"
            raise model.card.error(setting.offset, text)
        if key in values:
            raise model.card.error(setting.offset, f"{key} of the model {model.name} is given twice: leave one out")
        with home.recorded() as use:
            values[key] = home.number(model.card, setting.values[0])
        refuse_unsupported(model.card, use, values[key] if key == "r" else None)
        if use.used and rules.words.temperature_in_values:
            text = f"{rules.name} rounds an expression of the temperature in a model to about seven digits"
            scope.diagnostics.warn_ignored(model.card.spot(setting.offset), text)
    return values


def modelled_resistor(
    model: Model, scope: Scope, ohms: float | None, length: float | None, width: float | None, card: Card
) -> tuple[float, float, float, float, float]:
    """Return the resistance in ohms, tc1, tc2, the reference temperature and tce of a resistor with a model.

    The resistance holds at the reference temperature, in degrees Celsius (NaN for the deck's nominal temperature); tc1
    is in 1/K and tc2 in 1/K^2; tce, in 1/K, multiplies the resistance by ``1.01**(tce d)`` at ``d`` kelvin above the
    reference temperature.  `card`: card of the resistor; `scope`: parameter values at the resistor; `ohms`: value on
    the card, None without a value; `length, width`: on the card, in metres, None without a value.
    """
    exponential = card.rules.words.exponential_coefficient
    values = model_values(model, scope, _RESISTOR_KEYS | ({"tce"} if exponential else set()))
    if ohms is None:
        ohms = _from_model(values, length, width, card, model)
    elif card.rules.model_factor:
        ohms *= values.get("r", 1.0)
    first, second = values.get("tc1", 0.0), values.get("tc2", 0.0)
    return ohms, first, second, values.get("tnom", math.nan), values.get("tce", 0.0)


def _from_model(values: dict[str, float], length: float | None, width: float | None, card: Card, model: Model) -> float:
    """Return the resistance, in ohms, from the model's sheet resistance with length and width, or from its key ``r``.

    `values`: values of the model by key, such as ``rsh`` (ohms per square), ``l`` and ``w`` (metres); `length, width`:
    on the resistor's card, in metres, None for the model's values; `card`: the resistor's card; `model`: the model, for
    messages.
    """
    rules = card.rules
    span = values.get("l", _DEFAULT_LENGTH) if length is None else length
    broad = values.get("w", _DEFAULT_LENGTH) if width is None else width
    is_sheet = "rsh" in values and (length is not None or width is not None or "r" not in values)
    if rules.sheet_first:
        is_sheet = values.get("rsh", 0.0) * span * broad > 0
    if is_sheet:
        narrow, short = values.get("narrow", 0.0), values.get("short", 0.0)
        twice = 2.0 if rules.lengths_twice else 1.0
        if broad - twice * narrow <= 0 or span - twice * short <= 0:
            raise card.error(None, f"the model {model.name} leaves no length or width ({span:g} m, {broad:g} m)")
        if not rules.lengths_twice and (narrow or short):
            text = f"how {rules.name} uses narrow and short of the model {model.name} is not known here"
            raise card.error(None, text)
        return values["rsh"] * (span - twice * short) / (broad - twice * narrow)
    if "r" in values and not rules.model_factor:
        return values["r"]
    raise card.error(None, f"neither this line nor the model {model.name} gives a resistance (r, or rsh with l and w)")


def modelled_switch(model: Model, scope: Scope, state: float, card: Card) -> tuple[float, float, float, float, float]:
    """Return on and off resistance in ohms, upper and lower threshold in volts, and the state between thresholds.

    The thresholds are control voltages: above the upper one the switch is on, below the lower one off; if the first is
    less than the second, the other way round.  `model`: model of the switch; `card, scope`: card of the switch, and
    parameter values there; `state`: state between the thresholds that the card states, 1 for on and 0 for off.  The
    returned state is NaN if the switch is neither on nor off between the thresholds.
    """
    values = model_values(model, scope, _SWITCH_KEYS)
    on, off = values.get("ron", 1.0), values.get("roff", card.rules.off_ohms)
    if model.kind == "vswitch" or "von" in values or "voff" in values:
        upper, lower = values.get("von", 1.0), values.get("voff", 0.0)
        state = math.nan
    else:
        threshold, hysteresis = values.get("vt", 0.0), values.get("vh", 0.0)
        upper, lower = threshold + abs(hysteresis), threshold - abs(hysteresis)
        if hysteresis < 0:
            state = math.nan
    if on <= 0 or off <= 0:
        raise card.error(None, f"the switch model {model.name} has ron = {on:g}, roff = {off:g}: both must be positive")
    return on, off, upper, lower, state
