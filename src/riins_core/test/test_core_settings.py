"""Settings: what is taken, what is refused, and that the message says where and what was meant."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import pytest

from riins_core.settings import SettingError, as_mapping, build, declared, field_types, flatten, section, setting, unflatten


@dataclass(frozen=True)
class Inner:
    sigma_m: tuple[float, ...] = setting((1.0, 1.0, 1.0), "sigma by axis", "m", 0.0, 1e3, length=3)
    mode: str = setting("fast", "how", choices=("fast", "exact"))


@dataclass(frozen=True)
class Outer:
    name: str = setting(doc="what it is called")
    count: int = setting(3, "how many", low=1, high=10)
    gain: float = setting(0.5, "gain", "1/s", low=0.0)
    on: bool = setting(True, "on or off")
    limit: float | None = setting(None, "limit", "m", low=0.0)
    words: tuple[str, ...] = setting((), "any words")
    kind: str = setting("", "what it is", choices=("", "round"))
    inner: Inner = section(Inner, "the inner part")

    def __post_init__(self):
        if self.count == 7:
            raise SettingError("seven is unlucky", ("count",))


def test_defaults_nesting_and_whole_numbers():
    made = build(Outer, {"name": "x", "gain": 2, "limit": 4, "inner": {"sigma_m": [1, 2, 3.5]}})
    assert made == Outer("x", 3, 2.0, True, 4.0, inner=Inner((1.0, 2.0, 3.5)))
    assert isinstance(made.gain, float) and isinstance(made.limit, float) and isinstance(made.inner.sigma_m[0], float)
    assert build(Outer, {"name": "x", "limit": None}).limit is None


def test_mapping_round_trip():
    made = build(Outer, {"name": "x", "words": ["a", "b"], "inner": {"mode": "exact"}})
    plain = as_mapping(made)
    assert plain["words"] == ["a", "b"]
    assert build(Outer, plain) == made
    flat = flatten(plain)
    assert flat["inner.mode"] == "exact"
    assert unflatten(flat) == plain
    assert field_types(Outer)["count"] is int


@pytest.mark.parametrize(
    ("values", "message", "path"),
    [
        ({"name": "x", "gian": 1.0}, 'unknown setting "gian" (did you mean "gain"?)', ("gian",)),
        ({"name": "x", "inner": {"sigma": []}}, 'unknown setting "inner.sigma" (did you mean "sigma_m"?)', ("inner", "sigma")),
        ({}, '"name" is missing: what it is called', ("name",)),
        ({"name": 3}, '"name" must be a word, not 3', ("name",)),
        ({"name": "x", "count": 2.5}, "a whole number", ("count",)),
        ({"name": "x", "count": True}, "a whole number", ("count",)),
        ({"name": "x", "gain": "2"}, "must be a number, not '2': gain [1/s]", ("gain",)),
        ({"name": "x", "gain": float("nan")}, "finite", ("gain",)),
        ({"name": "x", "gain": None}, "a number", ("gain",)),
        ({"name": "x", "on": 1}, "true or false", ("on",)),
        ({"name": "x", "gain": -1.0}, "0.0 .. inf", ("gain",)),
        ({"name": "x", "count": 11}, "1 .. 10", ("count",)),
        ({"name": "x", "limit": -2}, "0.0 .. inf", ("limit",)),
        ({"name": "x", "inner": {"sigma_m": [1, 2]}}, "must have 3 elements, not 2", ("inner", "sigma_m")),
        ({"name": "x", "inner": {"sigma_m": [1, 2, -3]}}, "0.0 .. 1000.0", ("inner", "sigma_m", "2")),
        ({"name": "x", "inner": {"sigma_m": 1.0}}, "must be a list, not float", ("inner", "sigma_m")),
        ({"name": "x", "inner": {"mode": "exat"}}, "one of fast, exact, not 'exat' (did you mean \"exact\"?)", ("inner", "mode")),
        ({"name": "x", "inner": None}, "inner must be a mapping, not nothing", ("inner",)),
        ({"name": "x", "gain": -(10**400)}, '"gain" must be finite', ("gain",)),
        ({"name": "x", "kind": "rond"}, """one of "" (none), round, not 'rond' (did you mean "round"?)""", ("kind",)),
        ({"name": "x", "count": 7}, "seven is unlucky", ("count",)),
    ],
)
def test_refusals(values, message, path):
    with pytest.raises(SettingError) as caught:
        build(Outer, values)
    assert message in str(caught.value)
    assert caught.value.path == path
    assert "\n" not in str(caught.value)


def test_what_is_no_mapping_is_told_in_words():
    @dataclass(frozen=True)
    class Open:
        more: dict = field(default_factory=dict, metadata={"doc": "whatever"})  # type: ignore[type-arg]

    with pytest.raises(SettingError, match=r'"more" must be a mapping of names to values, not \[1\]: whatever'):
        build(Open, {"more": [1]})


def test_top_level_must_be_a_mapping():
    with pytest.raises(SettingError, match="the top level must be a mapping, not list"):
        build(Outer, [1])


@dataclass(frozen=True)
class Round:
    """A kind of section."""

    type: str = setting("round", "kind", choices=("round",))
    radius_m: float = setting(1.0, "radius", "m", 0.0, 10.0)


@dataclass(frozen=True)
class Square:
    """Another kind."""

    type: str = setting("square", "kind", choices=("square",))
    side_m: float = setting(2.0, "side", "m", 0.0, 10.0)


@dataclass(frozen=True)
class Shapes:
    """Settings with sections that the user names."""

    count: int = setting(1, "how many")
    shapes: tuple[str, ...] = setting(("ball",), "names")
    shape: Mapping[str, Any] = declared("shapes", lambda: {"round": Round, "square": Square}, {"ball": "round"})


def test_declared_sections_are_built_by_their_type_and_come_back() -> None:
    assert Shapes().shape == {"ball": Round()}
    values = {"shapes": ["ball", "box"], "box": {"type": "square", "side_m": 3}}
    config = build(Shapes, values)
    assert config.shape == {"ball": Round(), "box": Square(side_m=3.0)}
    plain = as_mapping(config)
    assert plain["box"] == {"type": "square", "side_m": 3.0} and plain["shapes"] == ["ball", "box"]
    assert build(Shapes, plain) == config and build(Shapes, unflatten(flatten(plain))) == config
    assert build(Shapes, {"shapes": []}).shape == {}


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"shapes": ["box"]}, r'"shapes" names "box", but there is no "box.type"; types are round, square'),
        ({"shapes": ["box"], "box": {"type": "sqare"}}, r'"box.type" must be one of round, square, not \'sqare\' \(did you mean "square"\?\)'),
        ({"box": {"type": "square"}}, r'unknown setting "box".* section that "shapes" should name'),
        ({"shapes": ["ball", "ball"]}, "twice"),
        ({"shapes": ["count"]}, "cannot be the name"),
        ({"shapes": ["two words"]}, "names 'two words', which cannot be the name of a section: letters, digits"),
        ({"shapes": ["b\u00e4ll"]}, "letters, digits"),
        ({"shapes": ["box"], "box": {"type": ["square"]}}, r'"box.type" must be one of round, square, not \[\'square\'\]'),
        ({"shapes": "ball"}, "must be a list of names"),
        ({"ball": {"radius_m": 11.0}}, r'"ball.radius_m" must be in'),
        ({"ball": {"side_m": 1.0}}, r'unknown setting "ball.side_m"'),
        ({"shape": {}}, r'unknown setting "shape"'),
        ({"ball": 3}, r"ball must be a mapping"),
    ],
)
def test_a_wrong_declaration_is_one_clear_line(values: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingError, match=said) as caught:
        build(Shapes, values)
    assert "\n" not in str(caught.value)
