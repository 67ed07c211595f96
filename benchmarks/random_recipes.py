"""Random recipes: hypothesis strategies over the descriptions' own fields, and ways to spoil a recipe.

A valid recipe is drawn field by field from the pydantic models: ranges, choices and lengths are read from them, so that
a new key is tried without a line here. `NARROW` keeps what must fit together (a marker inside the body, a camera that
looks at it) or what would cost minutes (a mesh for every sample). A spoilt recipe is a valid one with one key that no
validator may let through, chosen from the same fields.
"""

import math
import tomllib
import types
import typing
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from random import Random
from typing import Any, Literal

from hypothesis import strategies as st
from pydantic.fields import FieldInfo

from twin.parts.camera import Camera, Ccd, Light
from twin.parts.markers import MarkerLayer
from twin.parts.material import Cover, Material
from twin.parts.part import Part
from twin.parts.scene import Scene

Table = dict[str, Any]
Strategy = st.SearchStrategy[Any]

PROVENANCE = ("source", "assumed")

BODIES: dict[str, tuple[Table, tuple[float, float], float]] = {
    "block": ({"shape": "block", "width_mm": 100.0, "length_mm": 90.0, "thickness_mm": 40.0}, (14.0, 11.0), 6.0),
    "finger": ({"shape": "finger", "radius_mm": 8.0, "barrel_mm": 8.0, "skirt_mm": 2.0}, (3.0, 3.0), 2.0),
    "dome": ({"shape": "dome", "radius_mm": 10.0, "height_mm": 7.0}, (3.0, 3.0), 2.0),
}
"""Body, half extents of the places that are pressed, and the largest size of a probe, mm."""

MOST = {"float": 1e3, "int": 8}
NARROW: dict[tuple[str, str], Strategy] = {
    ("Material", "youngs_modulus_mpa"): st.floats(0.05, 20.0),
    ("Material", "poisson_ratio"): st.one_of(st.just(0.5), st.floats(0.0, 0.5)),
    ("Material", "refractive_index"): st.floats(1.0, 1.8),
    ("Term", "share"): st.floats(0.01, 0.3),
    ("Light", "colours"): st.just(()),  # as many as LEDs, which are drawn apart
    ("Ccd", "frames_per_second"): st.none(),  # exposure and readout must fit a frame
    ("Ccd", "readout_ms"): st.just(0.0),
    ("Reconstruction", "frames_per_second"): st.none(),  # for rubber that relaxes
    ("Cover", "thickness_mm"): st.floats(0.05, 0.4),
    ("Cover", "youngs_modulus_mpa"): st.none(),
    ("Cover", "poisson_ratio"): st.none(),
    ("Cover", "albedo"): st.tuples(*[st.floats(0.0, 0.5)] * 3),  # with what it lets through at most 1
    ("Cover", "transmittance"): st.floats(0.0, 0.5),
    ("MarkerLayer", "depth_mm"): st.floats(0.6, 3.0),
    ("MarkerLayer", "pitch_mm"): st.floats(0.8, 2.0),
    ("MarkerLayer", "diameter_mm"): st.floats(0.1, 0.7),
    ("MarkerLayer", "columns"): st.integers(1, 5),
    ("MarkerLayer", "rows"): st.integers(1, 5),
    ("MarkerLayer", "offset_mm"): st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    ("MarkerLayer", "colour"): st.tuples(*[st.floats(0.0, 1.0)] * 3),
    ("MarkerLayer", "stiff"): st.just(False),
    ("Camera", "width_px"): st.integers(40, 160),
    ("Camera", "height_px"): st.integers(40, 120),
    ("Camera", "focal_px"): st.floats(60.0, 600.0),
    ("Camera", "aspect"): st.floats(0.5, 2.0),
    ("Camera", "principal_px"): st.none(),
    ("Camera", "distortion"): st.sampled_from([(0.0, 0.0), (0.05, -0.01), (0.02, 0.0, 1e-3, -1e-3), (1e-2,) * 4, ()]),
    ("Camera", "aperture_mm"): st.floats(0.0, 2.0),
    ("Camera", "focus_z_mm"): st.floats(0.0, 5.0),
    ("Camera", "tilt_deg"): st.tuples(*[st.floats(-5.0, 5.0)] * 3),
    ("Camera", "layers"): st.lists(
        st.fixed_dictionaries({"index": st.floats(1.0, 2.0), "thickness_mm": st.floats(0.1, 5.0)}), max_size=3
    ),
    ("Marks", "count"): st.integers(1, 200),
    ("Marks", "size_mm"): st.floats(0.01, 3.0),
    ("Marks", "length_mm"): st.floats(0.0, 20.0),
    ("Marks", "depth_mm"): st.floats(0.6, 3.0),
    ("Light", "profile"): st.sampled_from([None, [[0.0, 1.0], [40.0, 0.5], [90.0, 0.0]]]),
    ("Light", "radius_mm"): st.floats(0.0, 3.0),
    ("Ccd", "crosstalk"): st.one_of(st.floats(0.0, 0.3), st.just([[0.9, 0.1, 0.0], [0.1, 0.8, 0.1], [0.0, 0.2, 0.8]])),
    ("Ccd", "quantum_efficiency"): st.tuples(*[st.floats(0.05, 1.0)] * 3),
    ("Ccd", "bandwidth_mhz"): st.tuples(*[st.floats(0.05, 20.0)] * 3),
    ("Accuracy", "displacement"): st.floats(5e-3, 0.2),
    ("Accuracy", "centroid_px"): st.one_of(st.just("auto"), st.floats(0.02, 1.0)),
    ("Accuracy", "contact_patches"): st.integers(6, 10),
    ("Tolerance", "poisson_ratio"): st.floats(0.0, 0.05),
    ("Tolerance", "thickness_mm"): st.floats(0.0, 0.05),
    ("Tolerance", "depth_mm"): st.floats(0.0, 0.05),
    ("Tolerance", "print_mm"): st.floats(0.0, 0.05),
    ("Tolerance", "tilt_deg"): st.floats(0.0, 1.0),
    ("Tolerance", "pupil_mm"): st.floats(0.0, 0.5),
    ("Tolerance", "distortion"): st.floats(0.0, 0.02),
    ("Reconstruction", "sites"): st.fixed_dictionaries(
        {"columns": st.integers(1, 5), "rows": st.integers(1, 5), "pitch_mm": st.floats(0.5, 1.2)}
    ),
    ("Reconstruction", "friction"): st.one_of(st.none(), st.floats(0.1, 2.0)),
}  # fmt: skip
"""Fields whose own range is wider than what fits together, or than what a sample may cost."""


def part(kind: type[Part], *, without: tuple[str, ...] = ()) -> Strategy:
    """Return a strategy for the table of a description: keys that have a default are given or left out."""
    needed, free = {}, {}
    for key, field in kind.model_fields.items():
        if key in (*PROVENANCE, *without):
            continue
        drawn = NARROW.get((kind.__name__, key), of_type(field.annotation, field.metadata))
        (needed if field.is_required() else free)[key] = drawn
    given = st.fixed_dictionaries(needed, optional=free)
    return given.map(lambda table: {key: value for key, value in table.items() if value is not None})


def of_type(annotation: Any, rules: typing.Sequence[Any] = ()) -> Strategy:
    """Return a strategy for a field's annotation within its rules."""
    origin, inside = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        return of_type(inside[0], [*rules, *_rules(inside[1:])])
    if origin in (typing.Union, types.UnionType):
        return st.one_of([of_type(each, rules) for each in inside])
    if origin is Literal:
        return st.sampled_from(inside)
    if origin is tuple:
        each = [of_type(a) for a in inside if a is not Ellipsis]
        return st.lists(each[0], max_size=3) if Ellipsis in inside else st.tuples(*each)
    low, high = bounds(rules)
    if annotation is float:
        low, high = (-MOST["float"] if low is None else low), (MOST["float"] if high is None else high)
        return st.floats(low, high, allow_nan=False, exclude_min=_is_open(rules, "gt"))
    if annotation is int:
        return st.integers(int(low or 0), int(min(high if high is not None else MOST["int"], 10**6)))
    plain = {bool: st.booleans(), type(None): st.none(), str: st.text(max_size=20)}
    if annotation in plain:
        return plain[annotation]
    return part(annotation)


def _rules(given: tuple[Any, ...]) -> list[Any]:
    return [rule for each in given for rule in getattr(each, "metadata", [each])]


def bounds(rules: typing.Sequence[Any]) -> tuple[float | None, float | None]:
    """Return the least and the largest value that a field's rules name."""
    named = {name: getattr(rule, name) for rule in rules for name in ("gt", "ge", "lt", "le") if hasattr(rule, name)}
    return named.get("ge", named.get("gt")), named.get("le", named.get("lt"))


def _is_open(rules: typing.Sequence[Any], name: str) -> bool:
    return any(hasattr(rule, name) for rule in rules)


@st.composite
def recipes(draw: Callable[[Strategy], Any]) -> Table:
    """Draw a whole recipe that is valid; what it computes may still be refused with a cause."""
    body, half, size = BODIES[draw(st.sampled_from(["block"] * 6 + ["finger", "dome"]))]
    # material.law stays linear: most of these presses are refused at finite strain
    rubber = part(Material, without=("law", "law_ratios"))
    accuracy, material, tolerance = draw(part(Scene.Accuracy)), draw(rubber), draw(part(Scene.Tolerance))
    if body["shape"] != "block":  # the block has a table, the others are solved, and have no one thickness
        tolerance.pop("thickness_mm", None)
        accuracy["displacement"] = draw(st.floats(0.03, 0.2))
        if accuracy.get("surface_table"):  # half a minute for each Poisson's ratio, so that all have the same
            material["poisson_ratio"], tolerance, accuracy["displacement"] = 0.5, {"preset": "none"}, 0.1
    table: Table = {
        "seed": draw(st.integers(0, 2**63 - 1)),
        "body": body,
        "material": material,
        "accuracy": accuracy,
        "tolerance": tolerance,
        "tracking": draw(part(Scene.Tracking)),
        "press": draw(presses(half, size)),
        "markers": draw(st.dictionaries(st.sampled_from(["red", "blue", "green"]), part(MarkerLayer), min_size=1)),
    }
    if draw(st.booleans()):
        table["cover"] = draw(part(Cover, without=("deforms",)))
    if draw(st.booleans()):
        table |= draw(sights(body))
        if "cover" in table and not table["cover"].get("transmittance"):
            table["light"].pop("outside", None)  # is hidden
    return table


@st.composite
def sights(draw: Callable[[Strategy], Any], body: Table) -> Table:
    """Draw camera, light, CCD and what is reconstructed, for a body."""
    base = body.get("thickness_mm") or body.get("height_mm") or body["radius_mm"] + body["skirt_mm"]
    camera = draw(part(Camera, without=("pupil_mm",)))
    kannala = camera.get("lens") == "equidistant"
    camera["distortion"] = [float(v) for v in camera.get("distortion", ())][: 2 if kannala else 5]
    front = base + sum(layer["thickness_mm"] for layer in camera.get("layers", ()))
    aside = st.floats(-2.0, 2.0)
    camera["pupil_mm"] = [draw(aside), draw(aside), front + draw(st.floats(0.0, 60.0))]
    light = draw(part(Light, without=("positions_mm", "lit")))
    spot = st.tuples(st.floats(-20.0, 20.0), st.floats(-20.0, 20.0), st.floats(front, front + 60.0))
    light["positions_mm"] = draw(st.lists(spot, min_size=1, max_size=4))
    light["lit"] = draw(st.sampled_from([[], [list(range(len(light["positions_mm"])))]]))
    for marks in (camera.get(kind, {}) for kind in ("dust", "scratches", "bubbles")):
        if marks.get("length_mm"):
            marks.pop("depth_mm", None)  # scratches lie on the window
    ccd = draw(part(Ccd))
    if ccd.get("bits", 8) != 8:
        ccd["jpeg_quality"] = "off"
    table: Table = {"camera": camera, "light": light, "ccd": ccd}
    if draw(st.booleans()):
        table["reconstruction"] = draw(part(Scene.Reconstruction))
    return table


@st.composite
def presses(draw: Callable[[Strategy], Any], half: tuple[float, float], size: float) -> Table:
    """Draw a press: a probe, a place, and one to three steps."""
    wide, push = draw(st.floats(0.3 * size, size)), draw(st.floats(0.01, 0.5))
    edge = draw(st.one_of(st.just(0.0), st.floats(0.0, 0.4 * wide)))
    probe = draw(
        st.sampled_from(
            [
                {"kind": "sphere", "diameter_mm": 2 * wide},
                {"kind": "cylinder", "diameter_mm": wide, "edge_mm": edge},
                {"kind": "pillar", "width_mm": wide, "length_mm": 0.7 * wide, "edge_mm": 0.5 * edge},
                {"kind": "cone", "apex_deg": 140.0, "diameter_mm": 3 * wide, "tip_mm": edge},
            ]
        )
    )
    friction = draw(st.one_of(st.just(0.0), st.just(math.inf), st.floats(0.05, 2.0)))
    table: Table = {"probe": probe, "at_mm": [draw(st.floats(-h, h)) for h in half], "friction": friction}
    if draw(st.integers(0, 3)) == 0:
        return table | {"indentation_mm": draw(st.floats(1e-3, 0.1))}
    then: list[Table] = [{"force_n": {"z": push}}]
    if draw(st.booleans()) and friction > 0:
        share, angle = draw(st.floats(0.0, 0.6)) * min(friction, 1.0), draw(st.floats(0.0, 2 * math.pi))
        side = {"x": share * push * math.cos(angle), "y": share * push * math.sin(angle), "z": push}
        then.append({"force_n": side})
    if draw(st.booleans()):
        then.append({"force_n": {"z": 0.7 * push}, "turn_deg": {"z": draw(st.floats(-2.0, 2.0))}})
    return table | {"steps": then}


@dataclass(frozen=True)
class Slot:
    """A key of a recipe: where it is, what its field says, what it holds."""

    path: tuple[Any, ...]
    field: FieldInfo | None
    value: Any


def slots(found: Part, path: tuple[Any, ...] = ()) -> list[Slot]:
    """Return every key of a validated description and of those inside it; one without a field is a whole table."""
    here = [Slot(path, None, found)] if path else []
    for key, field in type(found).model_fields.items():
        if key in PROVENANCE:
            continue
        value = getattr(found, key)
        here.append(Slot((*path, key), field, value))
        inner: Mapping[Any, Any] = value if isinstance(value, dict) else {}
        if isinstance(value, tuple):
            inner = dict(enumerate(value))
        if isinstance(value, Part):
            here += slots(value, (*path, key))
        for name, child in inner.items():
            if isinstance(child, Part):
                here += slots(child, (*path, key, name))
    return here


WORD = "neither a number nor a choice"


def spoilt_values(slot: Slot) -> list[Any]:
    """Return values that the field of a slot can't hold, whatever else the recipe says."""
    kinds = {kind for kind, _ in alternatives(slot.field.annotation)}
    wrong: list[Any] = []
    if not kinds & {str, dict, Part, object} or typing.get_origin(slot.field.annotation) is Literal:
        wrong.append(WORD)
    if not kinds & {dict, Part, object}:
        wrong.append({"unheard_of": 1})
    if not kinds & {tuple, object}:
        wrong.append([[[1]]])
    rules = rules_of(slot.field)
    low, high = bounds(rules)
    if kinds & {float, int} and not kinds & {object}:
        if slot.path[0] != "press" and not kinds & {int}:
            wrong += [math.nan, math.inf, -math.inf]
        wrong += [] if low is None else [low - 1.0 if float not in kinds else low - max(abs(low), 1e-3)]
        wrong += [] if high is None else [high * 2 + 1]
        wrong += [0.0] if _is_open(rules, "gt") and low == 0 else []
    return wrong


def alternatives(annotation: Any, rules: typing.Sequence[Any] = ()) -> Iterator[tuple[type, list[Any]]]:
    """Yield the kinds of value that an annotation takes, each with its rules."""
    origin, inside = typing.get_origin(annotation), typing.get_args(annotation)
    if origin is typing.Annotated:
        yield from alternatives(inside[0], [*rules, *_rules(inside[1:])])
    elif origin in (typing.Union, types.UnionType):
        for each in inside:
            yield from alternatives(each, rules)
    else:
        plain = {Literal: str, tuple: tuple, dict: dict}.get(origin, object if annotation is Any else annotation)
        yield (Part if issubclass(plain, Part) else plain), list(rules)


def rules_of(field: FieldInfo) -> list[Any]:
    """Return the rules of a field, and of what it may hold."""
    return [*field.metadata, *(rule for _, rules in alternatives(field.annotation) for rule in rules)]


@dataclass(frozen=True)
class Spoilt:
    """A recipe with one thing wrong, and the key that the complaint must name."""

    table: Table
    key: str
    how: str


@st.composite
def spoilt(draw: Callable[[Strategy], Any], valid: Strategy) -> Spoilt:
    """Draw a valid scene and spoil one of its keys."""
    scene: Scene = draw(valid)
    table = tomllib.loads(scene.to_toml())
    chance = Random(draw(st.integers(0, 2**32)))  # strategies lean towards what is listed first
    slot = chance.choice([s for s in slots(scene) if s.field is None or spoilt_values(s)])
    if slot.field is None:
        name = f"no_{chance.randrange(10**6)}"
        put(table, (*slot.path, name), 1)
        return Spoilt(table, name, "unknown key")
    if slot.field.is_required() and chance.random() < 0.3:
        _at(table, slot.path[:-1]).pop(slot.path[-1], None)
        return Spoilt(table, str(slot.path[-1]), "missing key")
    values = spoilt_values(slot)
    how = chance.choice(sorted({_how(v) for v in values}))
    put(table, slot.path, chance.choice([v for v in values if _how(v) == how]))
    return Spoilt(table, str(slot.path[-1]), how)


def _how(value: Any) -> str:
    if isinstance(value, str):
        return "another word"
    if isinstance(value, float) and not math.isfinite(value):
        return "not finite"
    return {dict: "a table", list: "a list"}.get(type(value), "out of range")


def put(table: Table, path: tuple[Any, ...], value: Any) -> None:
    _at(table, path[:-1])[path[-1]] = value


def _at(table: Any, path: tuple[Any, ...]) -> Any:
    for name in path:
        table = table.setdefault(name, {}) if isinstance(table, dict) else table[name]
    return table
