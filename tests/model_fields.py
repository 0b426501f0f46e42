"""Fields of MuJoCo's compiled models: the equations read them, need not, or cannot have them.

Each field of ``mjModel`` and its options is in a table here. A field of a later release that is in
none is found by `unknown`.
"""

from __future__ import annotations

from typing import Any

from problems.models.mjcf_parts import load_mujoco


def _listed(prefix: str, names: str) -> set[str]:
    return {prefix + name for name in names.split()}


#: Fields that the equations, the start or the names have.
READ = (
    {"qpos0", "qpos_spring", "npair", "exclude_signature"}
    | _listed("opt.", "timestep gravity wind density viscosity integrator disableactuator")
    | _listed("body_", "parentid weldid mocapid jntnum jntadr pos quat ipos iquat mass inertia")
    | _listed("body_", "gravcomp")
    | _listed("jnt_", "type qposadr dofadr pos axis stiffness stiffnesspoly")
    | _listed("jnt_", "actfrclimited actfrcrange actgravcomp limited springyield")
    | _listed("dof_", "jntid armature damping dampingpoly frictionloss")
    | _listed("geom_", "bodyid contype conaffinity fluid")
    | _listed("site_", "bodyid pos quat")
    | _listed("eq_", "type obj1id obj2id objtype active0 data")
    | _listed("actuator_", "ctrladr trnid gainprm biasprm damping dampingpoly armature group gear")
    | _listed("actuator_", "outadr forcelimited forcerange ctrllimited ctrlrange ctrlnum outnum")
    | _listed("actuator_", "trntype dyntype gaintype biastype delay")
    | _listed("key_", "qpos qvel ctrl mpos mquat")
)
#: Fields that change no motion here: they draw, name, count and measure; follow from others;
#: belong to parts that are refused; soften constraints, which are rigid here; or say how MuJoCo
#: steps and solves. Those of the objects in `_NO_MOTION` are all such.
IDLE = (
    {"vis", "stat", "names", "names_map", "paths", "signature", "plugin", "nconmax", "njmax"}
    | _listed("opt.", "impratio tolerance ls_tolerance noslip_tolerance ccd_tolerance magnetic")
    | _listed("opt.", "sleep_tolerance o_margin o_solref o_solimp o_friction cone jacobian solver")
    | _listed("opt.", "iterations ls_iterations noslip_iterations ccd_iterations sdf_initpoints")
    | _listed("opt.", "sdf_iterations disableflags enableflags")
    | _listed("body_", "rootid dofnum dofadr treeid geomnum geomadr simple sameframe subtreemass")
    | _listed("body_", "plugin invweight0 margin user contype conaffinity bvhadr bvhnum")
    | _listed("jnt_", "bodyid actuatorid group plasticadr solref solimp range margin user")
    | _listed("dof_", "bodyid parentid treeid Madr simplenum solref solimp invweight0 M0 length")
    | _listed("tree_", "bodyadr bodynum dofadr dofnum sleep_policy")
    | _listed("geom_", "type condim dataid matid group priority plugin sameframe castshadow solmix")
    | _listed("geom_", "solref solimp size aabb rbound pos quat friction margin gap surfacevel")
    | _listed("geom_", "adhesion user rgba")
    | _listed("site_", "type dataid matid group sameframe size user rgba")
    | _listed("eq_", "solref solimp")
    | _listed("actuator_", "actadr actnum ctrlspec cranklength dynprm actlimited actrange actearly")
    | _listed("actuator_", "history historyadr user plugin acc0 length0 lengthrange")
    | _listed("key_", "time act plastic")
    | _listed("flg_", "gravcomp surfacevel adhesion")
)
#: Beginnings of fields of objects that move nothing, or of parts that are refused.
_NO_MOTION = (
    "n", "bvh_", "oct_", "cam_", "light_", "flex_", "flexedge_", "efm0_", "efmC_", "mesh_", "skin_",
    "hfield_", "tex_", "mat_", "pair_", "tendon_", "ten_", "wrap_", "sensor_", "plugin_",
    "numeric_", "text_", "tuple_", "name_", "B_", "D_", "M_", "mapM2", "mapD2",
)  # fmt: skip


#: Flags that the equations read, and those that change no motion here; ``sleep`` is refused.
FLAGS = {
    "mjtDisableBit": _listed(
        "mjDSBL_",
        "CONSTRAINT EQUALITY FRICTIONLOSS LIMIT CONTACT SPRING DAMPER GRAVITY CLAMPCTRL WARMSTART "
        "FILTERPARENT ACTUATION REFSAFE SENSOR MIDPHASE EULERDAMP AUTORESET NATIVECCD ISLAND "
        "MULTICCD",
    ),
    "mjtEnableBit": _listed(
        "mjENBL_", "OVERRIDE ENERGY FWDINV INVDISCRETE SLEEP DIAGEXACT IPC SPECULATIVE"
    ),
}  # fmt: skip


def unknown(m: Any) -> list[str]:
    """Return the fields and flags of MuJoCo that are in no table here."""
    known, model = READ | IDLE, type(m)
    fields = {
        name
        for name in dir(model)
        if not name.startswith("_") and not callable(getattr(model, name)) and name != "opt"
    } | {f"opt.{name}" for name in dir(m.opt) if not name.startswith("_")}
    flags = {
        name
        for enumeration, those in FLAGS.items()
        for name in {*getattr(load_mujoco(), enumeration).__members__} - those
        if not name.startswith("mjN")
    }
    left = {name for name in fields - known if not name.startswith(_NO_MOTION)}
    return sorted(left | flags)
