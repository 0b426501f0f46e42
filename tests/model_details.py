"""Files of models of single actuators, flags and links of URDF, and all files by name."""

from __future__ import annotations

from model_files import LOOPS, ROBOTS, STUDENTS, File, actuated, body, chain, mjcf

#: What an actuator of MuJoCo can be, with what of it is refused.
ACTUATORS = {
    '<motor joint="j0" delay="0.004" nsample="2"/>': ("actuators",),
    '<motor joint="j0" armature=".2"/>': ("actuators",),
    '<motor joint="j0" damping=".3 .1"/>': ("actuators",),
    '<position joint="j0" kp="3" timeconst=".1"/>': ("actuators",),
    '<intvelocity joint="j0" kp="3" actrange="-1 1"/>': ("actuators",),
    '<damper joint="j0" kv="3" ctrlrange="0 1"/>': ("actuators",),
    '<velocity joint="j0" kv="3"/>': (),
    '<cylinder joint="j0"/>': ("actuators",),
    '<general joint="j0" gainprm="2" biastype="affine" biasprm="1 2 3"/>': (),
    '<general joint="j0" dyntype="user" actdim="1"/>': ("actuators",),
    '<general jointinparent="j0" gear="2"/>': (),
    '<general site="s" gear="1 0 0 0 1 0"/>': ("actuators",),
    '<adhesion body="l0" ctrlrange="0 1"/>': ("actuators",),
    '<dcmotor joint="j0" motorconst=".1" resistance="2"/>': ("actuators",),
    '<pid joint="j0" kp="3"/>': ("actuators",),
    '<motor joint="j0" group="2"/>': (),
}
FIELDS = {
    f"actuator {text[1:].split()[0]} {k}": File(mjcf(
        chain(2, inner='<site name="s"/>'), f"<actuator>{text}</actuator>",
        '<option actuatorgroupdisable="2"/>' if "group" in text else "<option/>",),
        left_out=left_out,)
    for k, (text, left_out) in enumerate(ACTUATORS.items())
} | {
    "control beyond its range": File(mjcf(chain(1), actuated("motor", 1, 'ctrlrange="-1 1"')
        + '<keyframe><key qpos=".3" ctrl="4"/></keyframe>',
        '<option><flag clampctrl="disable"/></option>')),
    "equality of tendons": File(mjcf(chain(2),
        '<tendon><fixed name="t"><joint joint="j0" coef="1"/></fixed></tendon>'
        '<equality><tendon tendon1="t"/></equality>',),
        left_out=("tendons", "equalities"),),
    "equality that is not active": File(
        mjcf(chain(2), '<equality><joint joint1="j0" joint2="j1" active="false"/></equality>')),
    "motor of a ball": File(mjcf(body('<joint name="b" type="ball"/>', "0 0 .4"),
        '<actuator><motor joint="b" gear="0 1 0"/></actuator>',),
        left_out=("actuators",),),
}  # fmt: skip

#: A little of all that a flag can switch off.
ALL = (
    chain(2, 'range="-20 20" frictionloss=".2" stiffness="3" damping=".4"', axes=("0 1 0",))
    + '<geom type="plane" size="1 1 1"/>'
)  # fmt: skip
ALL_ELSE = (
    actuated("motor", 1, 'ctrlrange="-1 1"')
    + '<equality><joint joint1="j0" joint2="j1"/></equality>'
    + '<keyframe><key qpos=".1 .1" qvel="1 1" ctrl="3"/></keyframe>'
)
OFF = (
    "constraint", "equality", "frictionloss", "limit", "contact", "spring", "damper", "gravity",
    "clampctrl", "warmstart", "filterparent", "actuation", "refsafe", "sensor", "midphase",
    "eulerdamp", "autoreset", "nativeccd", "island", "multiccd",
)  # fmt: skip
ON = ["override", "energy", "fwdinv", "invdiscrete", "sleep", "diagexact", "ipc", "speculative"]
#: What a flag asks for.
_OWN = {"ipc": ' integrator="discrete"'}
_RIGID = ("contacts", "limits", "friction_loss")
_GONE = {
    "constraint": _RIGID, "contact": ("contacts",), "limit": ("limits",),
    "frictionloss": ("friction_loss",),
}  # fmt: skip
FLAGS = {
    f"flag {flag}": File(mjcf(ALL, ALL_ELSE, f'<option><flag {flag}="disable"/></option>', ""),
        left_out=tuple(part for part in _RIGID if part not in _GONE.get(flag, ())),)
    for flag in OFF
} | {
    f"flag {flag}": File(mjcf(
        ALL, ALL_ELSE, f'<option{_OWN.get(flag, "")}><flag {flag}="enable"/></option>', ""),
        left_out=(*_RIGID, *(("sleep",) if flag == "sleep" else ())),)
    for flag in ON
} | {
    "flags spring and damper": File(
        mjcf(ALL.replace("<body ", '<body gravcomp=".2" '), ALL_ELSE,
             '<option density="2"><flag spring="disable" damper="disable"/></option>', ""),
        left_out=_RIGID,),
}  # fmt: skip


# ---- URDF
def link(name: str, shape: str = "", mass: float = 1.0) -> str:
    inertial = (
        f'<inertial><origin xyz="0 .01 .1" rpy=".1 0 0"/><mass value="{mass}"/><inertia ixx=".02" '
        f'iyy=".02" izz=".01" ixy="0" ixz=".001" iyz="0"/></inertial>'
    ) * bool(mass)
    shapes = f"<visual>{shape}</visual><collision>{shape}</collision>" * bool(shape)
    return f'<link name="{name}">{inertial}{shapes}</link>'


def joint(name: str, kind: str, parent: str, child: str, more: str = "") -> str:
    axis = '<axis xyz="0 1 0"/>' if kind not in ("fixed", "floating", "spherical") else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 .3" rpy="0 .1 0"/>{axis}{more}</joint>'
    )


def mesh(file: str) -> str:
    return f'<geometry><mesh filename="{file}" scale=".001 .001 .001"/></geometry>'


def urdf(*parts: str) -> str:
    return f'<?xml version="1.0"?><robot name="r">{"".join(parts)}</robot>'


LIMIT = '<limit lower="-1" upper="1" effort="30" velocity="2"/>'
URDF = {
    f"urdf with {file}": File(urdf(
        link("base", mesh(file), 0), link("arm", mesh(file)), link("tip", mesh(file)),
        joint("a", "continuous", "base", "arm"), joint("b", "continuous", "arm", "tip"),),
        ".urdf", ("contacts",),)
    for file in ("package://robot_description/meshes/arm.stl", "meshes/arm.obj", "arm.DAE")
} | {
    "urdf with limits": File(urdf(link("base", mass=0), link("arm"), link("tip"),
         joint("a", "revolute", "base", "arm", LIMIT),
         joint("b", "prismatic", "arm", "tip", LIMIT)),
        ".urdf", ("limits",),),
    "urdf that follows": File(urdf(link("base", mass=0), link("arm"), link("tip"),
         joint("a", "continuous", "base", "arm"),
         joint("b", "continuous", "arm", "tip", '<mimic joint="a" multiplier="-2"/>')),
        ".urdf",),
    "urdf that floats": File(urdf(link("base", mass=0), link("body"), link("arm"),
         joint("f", "floating", "base", "body"), joint("a", "continuous", "body", "arm")),
        ".urdf",),
    "urdf with friction": File(urdf(link("base", mass=0), link("arm"), joint(
        "a", "continuous", "base", "arm", '<dynamics damping=".1" friction=".2"/>')),
        ".urdf", ("friction_loss",),),
}  # fmt: skip

#: A mesh that is not beside the file.
LOST = '<asset><mesh name="arm" file="arm.stl"/></asset>'
MESHES = {
    "meshes for looks": File(mjcf('<body><joint axis="0 1 0"/><inertial pos="0 0 .2" mass="1" '
        'diaginertia=".1 .1 .01"/><geom type="mesh" mesh="arm"/></body>', LOST)),
    "meshes that weigh": File(
        mjcf('<body><joint/><geom type="mesh" mesh="arm"/></body>', LOST), refusal="arm.stl"),
}  # fmt: skip
FILES = LOOPS | ROBOTS | STUDENTS | FIELDS | FLAGS | URDF | MESHES
