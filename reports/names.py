"""Short names of integrators, as a person reads them; the printed name is their key.

`generalized_alpha[rho_inf=0.8,formulation=stabilised_index2,newton=modified]` is
`gα 0.8 · GGL · modified`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from bench.results.records import Record
from problems.base.spec import SpecError, split_spec


class BuiltIn(NamedTuple):
    """A built-in integrator: its short name, and hue in degrees, mark and dash of its line."""

    name: str
    hue: int
    mark: int
    dash: int


#: Looks, and the steps of options in `reports.charts.line_styles`, are the find of a search: in a
#: built-in suite, lines of nearly the same colour differ in mark or dash, and in both in the suites
#: that people run first.
BUILT_IN = {
    "generalized_alpha": BuiltIn("gα", 222, 0, 0),
    "generalized_alpha_adaptive": BuiltIn("gα adaptive", 188, 1, 2),
    "generalized_alpha_lie": BuiltIn("gα Lie", 198, 2, 5),
    "generalized_alpha_classical": BuiltIn("gα classical", 206, 0, 3),
    "hht": BuiltIn("HHT", 270, 3, 4),
    "hht_classical": BuiltIn("HHT classical", 280, 1, 0),
    "wbz": BuiltIn("WBZ", 296, 1, 3),
    "wbz_classical": BuiltIn("WBZ classical", 308, 0, 2),
    "newmark": BuiltIn("Newmark", 246, 5, 2),
    "ida": BuiltIn("IDA", 22, 0, 0),
    "cvode": BuiltIn("CVODE", 28, 13, 3),
    "bdf": BuiltIn("BDF", 335, 0, 0),
    "bdf_dae": BuiltIn("BDF DAE", 350, 5, 0),
    "radau": BuiltIn("Radau", 42, 5, 0),
    "radau_dae": BuiltIn("Radau DAE", 55, 6, 0),
    "kvaerno3": BuiltIn("Kvaerno3", 165, 4, 0),
    "kvaerno4": BuiltIn("Kvaerno4", 152, 5, 0),
    "kvaerno5": BuiltIn("Kvaerno5", 140, 2, 0),
    "kencarp3": BuiltIn("KenCarp3", 110, 7, 1),
    "kencarp4": BuiltIn("KenCarp4", 95, 5, 1),
    "kencarp5": BuiltIn("KenCarp5", 80, 4, 1),
    "implicit_euler": BuiltIn("Implicit Euler", 5, 1, 0),
    "dopri8": BuiltIn("Dopri8", 318, 15, 0),
    "ali3p": BuiltIn("ALI3-P", 34, 4, 3),
    "bathe": BuiltIn("Bathe", 190, 8, 6),
    "bdf2": BuiltIn("BDF2", 349, 9, 6),
    "bdf_adaptive": BuiltIn("BDF 1-5", 325, 5, 4),
    "bliedf": BuiltIn("BLieDF", 340, 7, 1),
    "cr": BuiltIn("CR", 238, 12, 3),
    "energy_momentum": BuiltIn("Energy-momentum", 169, 6, 4),
    "explicit_generalized_alpha": BuiltIn("explicit gα", 226, 6, 2),
    "half_explicit_euler": BuiltIn("Half-explicit Euler", 295, 5, 7),
    "hht_i3": BuiltIn("HHT-I3", 269, 0, 3),
    "houbolt": BuiltIn("Houbolt", 305, 13, 4),
    "implicit_fast": BuiltIn("Implicit fast", 12, 4, 4),
    "kr_alpha": BuiltIn("KR-α", 236, 7, 3),
    "linearly_implicit_euler": BuiltIn("Linearly implicit Euler", 348, 12, 0),
    "lobatto_iiia_iiib": BuiltIn("Lobatto A-B", 119, 9, 3),
    "moreau_jean": BuiltIn("Moreau-Jean", 15, 10, 5),
    "mujoco": BuiltIn("MuJoCo", 68, 11, 5),
    "noh_bathe": BuiltIn("Noh-Bathe", 214, 11, 7),
    "park": BuiltIn("Park", 311, 14, 6),
    "phem56": BuiltIn("PHEM56", 285, 13, 1),
    "radau_iia": BuiltIn("Radau IIA", 46, 11, 4),
    "rattle": BuiltIn("RATTLE", 95, 4, 3),
    "rho_inf_bathe": BuiltIn("ρ∞-Bathe", 180, 0, 6),
    "rodas5p": BuiltIn("Rodas5P", 62, 15, 2),
    "semi_implicit_euler": BuiltIn("Semi-implicit Euler", 0, 3, 3),
    "shake": BuiltIn("SHAKE", 89, 14, 1),
    "stormer_verlet": BuiltIn("Störmer-Verlet", 75, 10, 4),
    "tr_bdf2": BuiltIn("TR-BDF2", 196, 5, 7),
    "variational_midpoint": BuiltIn("Variational midpoint", 105, 5, 0),
    "wilson_theta": BuiltIn("Wilson-θ", 254, 3, 0),
}
#: Integrators that differ in parameters only.
_ALPHA_FAMILY = {
    *("generalized_alpha", "generalized_alpha_adaptive", "generalized_alpha_classical"),
    *("generalized_alpha_lie", "hht", "hht_classical", "wbz", "wbz_classical", "newmark"),
}
#: Names of families; others are called as their methods state it.
FAMILIES = {"generalized-alpha": "generalized-α", "engine": "engines"}
FAMILIES |= {"ida": "IDA", "cvode": "CVODE"}
#: Options whose value says enough.
_BARE = ("rho_inf", "alpha", "stages", "rho_b")
#: Options at values that go without saying, as the method is known by them.
_USUAL = {
    "newmark": {"beta": "0.25", "gamma": "0.5"},
    "ida": {"formulation": "stabilised_index2"},
    "bathe": {"gamma": "0.5"},
    "wilson_theta": {"theta": "1.4"},
    "noh_bathe": {"p": "0.54"},
    "moreau_jean": {"theta": "0.5"},
    "linearly_implicit_euler": {"erp": "1.0"},
    "rattle": {"multiplier": "averaged"},
    "variational_midpoint": {"multiplier": "averaged"},
    "semi_implicit_euler": {"erp": "0.2"},
    "implicit_fast": {"erp": "0.2"},
}
#: Forms of a constrained system, and what becomes of the drift off its constraints.
_FORMS = {
    **{"index3": "index 3", "index2": "index 2", "index1": "index 1", "ode": "index 1"},
    **{"stabilised_index2": "GGL", "joint_coordinates": "minimal coordinates"},
    **{"unprojected": "unprojected", "projected": "projected", "baumgarte": "Baumgarte"},
    "soft": "soft loops",
}
#: Values of options in words; others are told with the option.
_VALUES = {
    "formulation": _FORMS,
    "constraints": _FORMS,
    "newton": {"full": "full Newton", "modified": "modified", "modified_exact": "modified, exact"},
    "start": {"corrected": "corrected start", "consistent": "plain start"},
    "gamma": {"updated": "γ updated", "guarded": "γ guarded"},
    "linear_solver": {"sparse": "sparse", "dense": "dense"},
    "steps": {"constant": "constant steps"},
    "values": {"equations": "a, λ of the equations"},
    "multiplier": {"one_sided": "one-sided λ"},
    "method": {"adams": "Adams"},
    "integrator": {"euler": "Euler", "rk4": "RK4"},
}
_GREEK = {
    **{"alpha_m": "αm", "alpha_f": "αf", "delta_m": "δm", "delta_f": "δf"},
    **{"beta": "β", "gamma": "γ", "theta": "θ"},
}
Options = dict[str, str]


def short_name(label: str) -> str:
    """The short name of one integrator, with all of its options."""
    return _written(*_parts(label))


def short_names(labels: Iterable[str]) -> dict[str, str]:
    """A short name for each label, in their order; no two are the same.

    Left out are options that all members of a family have in common, those that always come with
    another one, and the way of Newton's method if all that state one state the same.
    """
    parts = {label: _parts(label) for label in dict.fromkeys(labels)}
    families: dict[str, dict[str, Options]] = {}
    for label, (name, options, _) in parts.items():
        families.setdefault("" if name in _ALPHA_FAMILY else name, {})[label] = options
    own = [each.values() for each in families.values()]
    stated = [o.get("newton") for each in own if any("newton" in o for o in each) for o in each]
    common = {"newton"} if len(stated) > 1 and len({*stated}) == 1 else set()
    found = {}
    for members in families.values():
        needless = common | _needless([*members.values()])
        for label, options in members.items():
            name, _, steps = parts[label]
            kept = {key: value for key, value in options.items() if key not in needless}
            found[label] = _written(name, kept, steps)
    # The plainer name may be that of another integrator: then the full one is said.
    for name_of in (short_name, str):
        counts = Counter(found.values())
        found = {k: name_of(k) if counts[v] > 1 else v for k, v in found.items()}
    return {label: found[label] for label in parts}


def form_name(runs: Iterable[Record | None]) -> str:
    """The form in which runs of a method solve constraints: 'index 2, projected'; or nothing."""
    stated = (run.formulation.split(", ") for run in runs if run and run.constraint)
    return ", ".join(_FORMS[part] for part in next(stated, []) if part in _FORMS)


def scene_name(scene: str) -> str:
    """A scene as a person reads it: `slider_crank[l1=2]` is `slider crank[l1=2]`."""
    name, bracket, rest = scene.partition("[")
    return name.replace("_", " ") + bracket + rest


def label_parts(label: str) -> tuple[str, Options, str]:
    """Name, options and pattern of steps; a label that is no specification is all name."""
    spec, _, steps = label.partition(" x ")
    try:
        return *split_spec(spec), steps
    except SpecError:
        return label, {}, ""


def _parts(label: str) -> tuple[str, Options, str]:
    """The parts that are said."""
    name, options, steps = label_parts(label)
    usual = _USUAL.get(name, {})
    said = {k: v.removesuffix(".0") for k, v in options.items() if usual.get(k) != v}
    return name, said, steps


def _written(name: str, options: Mapping[str, str], steps: str) -> str:
    known = BUILT_IN[name].name if name in BUILT_IN else name
    head = " ".join([known, *(options[key] for key in _BARE if key in options)])
    rest = [
        _VALUES.get(key, {}).get(value) or f"{_GREEK.get(key, key.replace('_', ' '))} {value}"
        for key, value in options.items()
        if key not in _BARE
    ]
    return " · ".join([head, *rest, *([f"steps {steps}"] if steps else [])])


def _needless(members: Sequence[Options]) -> set[str]:
    """Options that tell no two members apart: alike in all, or parted as an earlier one is."""
    if len(members) < 2:
        return set()
    seen: set[tuple[int, ...]] = {(0,) * len(members)}
    needless = set()
    for key in dict.fromkeys(key for options in members for key in options if key not in _BARE):
        values = [options.get(key) for options in members]
        parting = tuple(values.index(value) for value in values)
        if parting in seen:
            needless.add(key)
        seen.add(parting)
    return needless
