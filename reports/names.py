"""Short names of integrators, as a person reads them; the printed name is their key.

`generalized_alpha[rho_inf=0.8,formulation=stabilised_index2,newton=modified]` is
`gα 0.8 · GGL · modified`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

from problems.spec import SpecError, split_spec

#: Short names of the built-in integrators; those of the first family differ in parameters only.
_ALPHA_FAMILY = {
    "generalized_alpha": "gα",
    "generalized_alpha_adaptive": "gα adaptive",
    "generalized_alpha_classical": "gα classical",
    "hht": "HHT",
    "hht_classical": "HHT classical",
    "wbz": "WBZ",
    "wbz_classical": "WBZ classical",
    "newmark": "Newmark",
}
BUILT_IN = _ALPHA_FAMILY | {
    "ida": "IDA",
    "cvode": "CVODE",
    "bdf": "BDF",
    "bdf_dae": "BDF DAE",
    "radau": "Radau",
    "radau_dae": "Radau DAE",
    "kvaerno3": "Kvaerno3",
    "kvaerno4": "Kvaerno4",
    "kvaerno5": "Kvaerno5",
    "kencarp3": "KenCarp3",
    "kencarp4": "KenCarp4",
    "kencarp5": "KenCarp5",
    "implicit_euler": "Implicit Euler",
    "dopri8": "Dopri8",
    "ali3p": "ALI3-P",
    "bathe": "Bathe",
    "bdf2": "BDF2",
    "bdf_adaptive": "BDF 1-5",
    "cr": "CR",
    "energy_momentum": "Energy-momentum",
    "exudyn": "exudyn",
    "explicit_generalized_alpha": "explicit gα",
    "half_explicit_euler": "Half-explicit Euler",
    "hht_i3": "HHT-I3",
    "houbolt": "Houbolt",
    "implicit_fast": "Implicit fast",
    "kr_alpha": "KR-α",
    "linearly_implicit_euler": "Linearly implicit Euler",
    "lobatto_iiia_iiib": "Lobatto A-B",
    "mujoco": "MuJoCo",
    "noh_bathe": "Noh-Bathe",
    "park": "Park",
    "phem56": "PHEM56",
    "radau_iia": "Radau IIA",
    "rattle": "RATTLE",
    "rho_inf_bathe": "ρ∞-Bathe",
    "rodas5p": "Rodas5P",
    "semi_implicit_euler": "Semi-implicit Euler",
    "shake": "SHAKE",
    "stormer_verlet": "Störmer-Verlet",
    "tr_bdf2": "TR-BDF2",
    "variational_midpoint": "Variational midpoint",
    "wilson_theta": "Wilson-θ",
}
#: Names of families; others are called as their methods state it.
_FAMILIES = {
    "generalized-alpha": "generalized-α",
    "ida": "IDA",
    "cvode": "CVODE",
    "scipy_dae": "scipy DAE",
    "engine": "engines",
}
#: Options whose value says enough.
_BARE = ("rho_inf", "alpha", "stages", "rho_b")
#: Values that go without saying, as the method is known by them.
_USUAL = {
    ("newmark", "beta", "0.25"),
    ("newmark", "gamma", "0.5"),
    ("ida", "formulation", "stabilised_index2"),
    ("bathe", "gamma", "0.5"),
    ("wilson_theta", "theta", "1.4"),
    ("noh_bathe", "p", "0.54"),
    ("rattle", "multiplier", "averaged"),
    ("variational_midpoint", "multiplier", "averaged"),
    ("semi_implicit_euler", "erp", "0.2"),
    ("implicit_fast", "erp", "0.2"),
    ("linearly_implicit_euler", "erp", "1.0"),
}
_VALUES = {
    ("formulation", "stabilised_index2"): "GGL",
    ("formulation", "index1"): "index 1",
    ("formulation", "index2"): "index 2",
    ("formulation", "index3"): "index 3",
    ("newton", "modified"): "modified",
    ("start", "corrected"): "corrected start",
    ("gamma", "updated"): "γ updated",
    ("gamma", "guarded"): "γ guarded",
    ("linear_solver", "sparse"): "sparse",
    ("linear_solver", "dense"): "dense",
    ("steps", "constant"): "constant steps",
    ("values", "equations"): "a, λ of the equations",
    ("multiplier", "one_sided"): "one-sided λ",
    ("constraints", "baumgarte"): "Baumgarte",
    ("constraints", "projected"): "projected",
    ("method", "trapezoidal_index2"): "trapezoidal",
    ("integrator", "euler"): "Euler",
    ("integrator", "rk4"): "RK4",
    ("method", "adams"): "Adams",
}
_GREEK = {
    "alpha_m": "αm",
    "alpha_f": "αf",
    "beta": "β",
    "gamma": "γ",
    "delta_m": "δm",
    "delta_f": "δf",
    "theta": "θ",
    "rho_inf_x": "ρx",
}
Options = dict[str, str]


def short_name(label: str) -> str:
    """The short name of one integrator, with all of its options."""
    return _written(*_parts(label))


def short_names(labels: Iterable[str]) -> dict[str, str]:
    """A short name for each label, in their order; no two are the same.

    Left out are options that all members of a family have in common, and those that always come
    with another one.
    """
    parts = {label: _parts(label) for label in dict.fromkeys(labels)}
    families: dict[str, list[str]] = {}
    for label, (name, _, _) in parts.items():
        families.setdefault("" if name in _ALPHA_FAMILY else name, []).append(label)
    found = {}
    for members in families.values():
        needless = _needless([parts[label][1] for label in members])
        for label in members:
            name, options, steps = parts[label]
            kept = {key: value for key, value in options.items() if key not in needless}
            found[label] = _written(name, kept, steps)
    # The plainer name may be that of another integrator: then the full one is said.
    for name_of in (short_name, str):
        counts = Counter(found.values())
        found = {k: name_of(k) if counts[v] > 1 else v for k, v in found.items()}
    return {label: found[label] for label in parts}


def scene_name(scene: str) -> str:
    """A scene as a person reads it: `slider_crank[l1=2]` is `slider crank[l1=2]`."""
    name, bracket, rest = scene.partition("[")
    return name.replace("_", " ") + bracket + rest


def family_name(family: str) -> str:
    """A family of integrators as a person reads it."""
    return _FAMILIES.get(family, family)


def _parts(label: str) -> tuple[str, Options, str]:
    """Name, options and pattern of steps; a label that is no specification is all name."""
    spec, _, steps = label.partition(" x ")
    try:
        name, options = split_spec(spec)
    except SpecError:
        return label, {}, ""
    said = {k: v for k, v in options.items() if (name, k, v) not in _USUAL}
    return name, said, steps


def _written(name: str, options: Mapping[str, str], steps: str) -> str:
    head = " ".join(
        [BUILT_IN.get(name, name), *(_number(options[key]) for key in _BARE if key in options)]
    )
    rest = [_option(key, value) for key, value in options.items() if key not in _BARE]
    return " · ".join([head, *rest, *([f"steps {steps}"] if steps else [])])


def _option(key: str, value: str) -> str:
    known = _VALUES.get((key, value))
    return known or f"{_GREEK.get(key, key.replace('_', ' '))} {_number(value)}"


def _number(value: str) -> str:
    return value.removesuffix(".0")


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
