"""Fields of MuJoCo's compiled models: the equations read them, need not, or cannot have them.

Each field of ``mjModel`` and its options is in a table here. A field of a later release that is in
none is found by `unknown`.
"""

from __future__ import annotations

from typing import Any

from problems.models.mjcf_parts import load_mujoco


def _listed(table: str) -> set[str]:
    """Names by their beginnings, the first word of each line ("-": none)."""
    rows = (line.split() for line in table.strip().splitlines())
    return {first.strip("-") + name for first, *names in rows for name in names}


#: Fields that the equations, the start or the names have.
READ = _listed("""
- exclude_signature npair qpos0 qpos_spring
actuator_ armature biasprm biastype ctrladr ctrllimited ctrlnum ctrlrange damping dampingpoly delay
actuator_ dyntype forcelimited forcerange gainprm gaintype gear group outadr outnum trnid trntype
body_ gravcomp inertia ipos iquat jntadr jntnum mass mocapid parentid pos quat weldid
dof_ armature damping dampingpoly frictionloss jntid
eq_ active0 data obj1id obj2id objtype type
geom_ bodyid conaffinity contype
jnt_ actfrclimited actfrcrange axis dofadr limited pos qposadr springyield stiffness stiffnesspoly
jnt_ type
key_ ctrl mpos mquat qpos qvel
opt. density disableactuator gravity integrator timestep viscosity
site_ bodyid pos quat
""")
#: Fields that change no motion here: they draw, name, count and measure; follow from others;
#: belong to parts that are refused; soften constraints, which are rigid here; or say how MuJoCo
#: steps and solves. Those of the objects in `_NO_MOTION` are all such.
IDLE = _listed("""
- names names_map nconmax njmax paths plugin signature stat vis
actuator_ acc0 actadr actearly actlimited actnum actrange cranklength ctrlspec dynprm history
actuator_ historyadr length0 lengthrange plugin user
body_ bvhadr bvhnum conaffinity contype dofadr dofnum geomadr geomnum invweight0 margin plugin
body_ rootid sameframe simple subtreemass treeid user
dof_ M0 Madr bodyid invweight0 length parentid simplenum solimp solref treeid
eq_ solimp solref
flg_ adhesion gravcomp surfacevel
geom_ aabb adhesion castshadow condim dataid fluid friction gap group margin matid plugin pos
geom_ priority quat rbound rgba sameframe size solimp solmix solref surfacevel type user
jnt_ actgravcomp actuatorid bodyid group margin plasticadr range solimp solref user
key_ act plastic time
opt. ccd_iterations ccd_tolerance cone disableflags enableflags impratio iterations jacobian
opt. ls_iterations ls_tolerance magnetic noslip_iterations noslip_tolerance o_friction o_margin
opt. o_solimp o_solref sdf_initpoints sdf_iterations sleep_tolerance solver tolerance wind
site_ dataid group matid rgba sameframe size type user
tree_ bodyadr bodynum dofadr dofnum sleep_policy
""")
#: Beginnings of fields of objects that move nothing, or of parts that are refused.
_NO_MOTION = (
    "n", "bvh_", "oct_", "cam_", "light_", "flex_", "flexedge_", "efm0_", "efmC_", "mesh_", "skin_",
    "hfield_", "tex_", "mat_", "pair_", "tendon_", "ten_", "wrap_", "sensor_", "plugin_",
    "numeric_", "text_", "tuple_", "name_", "B_", "D_", "M_", "mapM2", "mapD2",
)  # fmt: skip


#: Flags that the equations read, and those that change no motion here; ``sleep`` is refused.
FLAGS = {
    "mjtDisableBit": _listed("""
mjDSBL_ ACTUATION AUTORESET CLAMPCTRL CONSTRAINT CONTACT DAMPER EQUALITY EULERDAMP FILTERPARENT
mjDSBL_ FRICTIONLOSS GRAVITY ISLAND LIMIT MIDPHASE MULTICCD NATIVECCD REFSAFE SENSOR SPRING
mjDSBL_ WARMSTART
"""),
    "mjtEnableBit": _listed("""
mjENBL_ DIAGEXACT ENERGY FWDINV INVDISCRETE IPC OVERRIDE SLEEP SPECULATIVE
"""),
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
