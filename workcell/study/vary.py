"""Which variation of a scenario is run k of seed S.

A scenario with a `[vary]` table comes in; for any run number, a concrete scenario goes out. Every
key has a stream of its own, seeded by (S, k, key): a draw depends neither on the workers, nor on
the runs before it, nor on what else is varied. All draws start as uniform numbers in [0, 1), which
the distribution of the key maps to its values, so a search can walk through the same space.
"""

from __future__ import annotations

import math
import zlib
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from workcell import scenario as scenario_file
from workcell.errors import InputError
from workcell.scenario import Scenario, Variation

_BELOW_ONE = math.nextafter(1.0, 0.0)


def load_variations(
    scenario: str, overrides: tuple[str, ...] = (), choice: tuple[str, ...] = ()
) -> Variations:
    """The variations of a scenario file, but for keys that are set by hand: what is set is not drawn.

    Args:
        scenario: Name or path.
        overrides: `KEY=VALUE`; such a key of `[vary]` is taken out of it.
        choice: Further `KEY=VALUE`, which leave `[vary]` as it is.
    """
    loaded = scenario_file.load(scenario, (*overrides, *choice))
    fixed = {item.partition("=")[0].strip() for item in overrides}
    drawn = {key: law for key, law in loaded.vary.items() if key not in fixed}
    return Variations(loaded.model_copy(update={"vary": drawn}))


class Variations:
    """The variations of one scenario.

    Args:
        scenario: With a `[vary]` table; its keys are dotted keys of the file, an arm or obstacle
            addressed by its name, an entry of a list by its index (`"arm.nurse.job.0.speed_m_s"`).

    Raises:
        InputError: a key does not exist or an end of its range is not allowed there.
    """

    def __init__(self, scenario: Scenario):
        self._content = scenario.model_dump(mode="json")
        self._path = scenario._file
        # A variation is concrete, and the file's bounds are those of the file as it stands.
        self._content["vary"], self._content["expect"] = {}, {}
        faults: list[str] = []
        self.keys: tuple[VariedKey, ...] = ()
        for key, law in scenario.vary.items():
            try:
                node, last = _locate(self._content, key)
                varied = VariedKey(key, law, _nominal(key, law, node[last]))
            except InputError as error:
                faults += error.faults
                continue
            self.keys += (varied,)
            faults += self._faults_at_the_ends(varied)
        if faults:
            raise InputError(faults, file=scenario.file)

    @property
    def width(self) -> int:
        """How many uniform numbers a variation takes."""
        return sum(key.width for key in self.keys)

    @property
    def content(self) -> dict[str, Any]:
        """What is varied, as a parsed file."""
        return _copy(self._content)

    @property
    def laws(self) -> dict[str, Any]:
        """How, by key: with `content` and a seed it fixes every run."""
        return {key.name: key.law.model_dump(mode="json") for key in self.keys}

    def draw(self, seed: int, run: int) -> dict[str, Any]:
        """The values of run `run` of seed `seed`, by key."""
        return {
            key.name: key.value(
                np.random.default_rng([seed, run, zlib.crc32(key.name.encode())]).random(key.width)
            )
            for key in self.keys
        }

    def at(self, point: NDArray[np.float64]) -> dict[str, Any]:
        """The values at a point (width,) of the unit cube, by key."""
        values, start = {}, 0
        for key in self.keys:
            values[key.name] = key.value(np.clip(point[start : start + key.width], 0.0, _BELOW_ONE))
            start += key.width
        return values

    def nominal(self) -> dict[str, Any]:
        """What the file itself says, by key."""
        return {key.name: key.nominal for key in self.keys}

    def scenario(self, values: dict[str, Any]) -> Scenario:
        """The concrete scenario with these values.

        Raises:
            InputError: the values do not go together.
        """
        content = _copy(self._content)
        for key, value in values.items():
            node, last = _locate(content, key)
            node[last] = value
        return scenario_file.validate(content, self._path)

    def _faults_at_the_ends(self, key: VariedKey) -> list[str]:
        faults: list[str] = []
        for value in key.ends():
            try:
                self.scenario({key.name: value})
            except InputError as error:
                faults += [f'vary."{key.name}": {fault}' for fault in error.faults]
        return list(dict.fromkeys(faults))


@dataclass(frozen=True)
class VariedKey:
    """One key of `[vary]` and how uniform numbers become its values."""

    name: str
    """Dotted key."""
    law: Variation
    """Its distribution."""
    nominal: Any
    """The value in the file."""

    @property
    def width(self) -> int:
        """How many uniform numbers a value takes: one, or with `plus_minus` one a list entry."""
        spread = self.law.plus_minus is not None and isinstance(self.nominal, (list, tuple))
        return len(self.nominal) if spread else 1

    def value(self, uniform: NDArray[np.float64]) -> Any:
        """The value that (width,) uniform numbers in [0, 1) stand for."""
        law, u = self.law, float(uniform[0])
        if law.choices is not None:
            return law.choices[int(u * len(law.choices))]
        if law.plus_minus is not None:
            offset = (2.0 * uniform - 1.0) * law.plus_minus
            if isinstance(self.nominal, (list, tuple)):
                return [float(x + o) for x, o in zip(self.nominal, offset, strict=True)]
            return float(self.nominal + offset[0])
        if law.mean is not None and law.sd is not None:
            low, high = (
                (0.0, 1.0)
                if law.min is None or law.max is None
                else ndtr((np.array([law.min, law.max]) - law.mean) / law.sd)
            )
            # Half a step of the generator off the ends, where a normal without ends is infinite.
            share = min(max(u, 2.0**-54), _BELOW_ONE)
            return float(law.mean + law.sd * ndtri(low + (high - low) * share))
        return _in_range(law, u)

    def ends(self) -> list[Any]:
        """Values that must be allowed for all to be: every choice, or both ends of the range."""
        if self.law.choices is not None:
            return list(self.law.choices)
        return [self.value(np.full(self.width, u)) for u in (0.0, _BELOW_ONE)]


def _in_range(law: Variation, u: float) -> float | int:
    low, high = law.min, law.max
    if low is None or high is None:
        raise ValueError("the schema lets no range through without both its ends")
    if isinstance(low, int) and isinstance(high, int):
        # Whole ends mean whole numbers, both ends included.
        return low + int(u * (high - low + 1))
    if law.log:
        return float(low * (high / low) ** u)
    return float(low + u * (high - low))


def _locate(content: dict[str, Any], key: str) -> tuple[Any, Any]:
    """The table or list that holds a dotted key, and the place in it.

    Raises:
        InputError: there is no such key.
    """
    node: Any = content
    found: list[tuple[Any, Any]] = []
    for part in key.split("."):
        if isinstance(node, dict):
            names: dict[str, Any] = {name: name for name in node if name not in ("vary", "expect")}
        elif isinstance(node, list):
            names = {str(index): index for index in range(len(node))}
            names |= {
                item["name"]: i
                for i, item in enumerate(node)
                if isinstance(item, dict) and "name" in item
            }
        else:
            names = {}
        if part not in names:
            allowed = ", ".join(names) or "nothing: this is a value"
            raise InputError(f'vary."{key}": no key {part!r} here; allowed: {allowed}')
        found.append((node, names[part]))
        node = node[names[part]]
    return found[-1]


def _nominal(key: str, law: Variation, value: Any) -> Any:
    """The value in the file, refused where a spread around it has no meaning."""
    if law.plus_minus is not None:
        entries = value if isinstance(value, (list, tuple)) else [value]
        if not all(isinstance(x, (int, float)) and not isinstance(x, bool) for x in entries):
            raise InputError(
                f'vary."{key}".plus_minus: the value in the file is {value!r}; a number or a list of numbers is needed'
            )
    return value


def _copy(value: Any) -> Any:
    """A copy of nested tables and lists, their values shared."""
    if isinstance(value, dict):
        return {k: _copy(v) for k, v in value.items()}
    return [_copy(v) for v in value] if isinstance(value, (list, tuple)) else value
