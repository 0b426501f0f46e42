"""Files of models as people have them, made of snippets; none is a copy of one that exists."""

from typing import NamedTuple


class File(NamedTuple):
    """The text of a file, its ending, and the parts that have to be left out, or the sentence
    of a refusal."""

    text: str
    suffix: str = ".xml"
    left_out: tuple[str, ...] = ()
    refusal: str = ""


#: Geometries that touch nothing.
GHOST = '<default><geom contype="0" conaffinity="0"/></default>'


def mjcf(bodies: str, rest: str = "", option: str = "<option/>", default: str = GHOST) -> str:
    return f"<mujoco>{option}{default}<worldbody>{bodies}</worldbody>{rest}</mujoco>"


def body(joint: str, to: str, inner: str = "", at: str = "0 0 0", name: str = "", turn: str = ""):
    named = f' name="{name}"' * bool(name)
    turned = f' euler="{turn}"' * bool(turn)
    geom = f'<geom type="capsule" fromto="0 0 0 {to}" size=".02" density="900"/>'
    return f'<body{named} pos="{at}"{turned}>{joint}{geom}{inner}</body>'


def hinge(name: str, axis: str = "0 1 0", more: str = "") -> str:
    return f'<joint name="{name}" axis="{axis}" {more}/>'


def chain(n: int, more: str = "", inner: str = "", axes: tuple[str, ...] = ("0 0 1", "0 1 0")):
    """Links upon links, each with a hinge j0, j1, ..."""
    text = inner
    for k in reversed(range(n)):
        joint = hinge(f"j{k}", axes[k % len(axes)], more)
        text = body(joint, "0.05 0 .3", text, "0 0 0" if k == 0 else "0.05 0 .3", f"l{k}")
    return text


def actuated(kind: str, joints: int, more: str = "") -> str:
    own = "".join(f'<{kind} name="m{k}" joint="j{k}" {more}/>' for k in range(joints))
    return f"<actuator>{own}</actuator>"


def four_bar(turn: str = "", tie: str = "", inner: str = "") -> str:
    """A plane four-bar linkage in a body that is turned."""
    tie = tie or '<connect name="pin" body1="coupler" body2="rocker" anchor=".4 0 .1"/>'
    linkage = body(
        hinge("crank"), ".1 0 .2", body(hinge("coupler"), ".4 0 .1", at=".1 0 .2", name="coupler")
    ) + body(hinge("rocker"), "0 0 .3", at=".5 0 0", name="rocker")
    base = f'<body name="base" pos="0 0 1" euler="{turn or "0 0 0"}">{inner}{linkage}</body>'
    return mjcf(base, f"<equality>{tie}</equality>")


FREE = '<freejoint/><geom type="box" size=".1 .2 .05"/>'
LOOPS = {
    f"four bar turned {turn}": File(four_bar(turn))
    for turn in ("", "20 35 50")
} | {
    "four bar on a free base": File(four_bar("20 35 50", inner=FREE)),
    "four bar on a turntable": File(
        four_bar("10 0 0", inner=hinge("table", "0 0 1") + '<geom size=".1"/>')),
    "gripper that a weld carries": File(mjcf(
        body(hinge("a", "1 0 0"), "0 0 .3", body(hinge("b", "1 0 0"), "0 .3 0", at="0 0 .3"),
             turn="10 20 30", name="one")
        + body("<freejoint/>", ".1 0 .1", at=".2 0 .4", name="two"),
        '<equality><weld body1="one" body2="two"/></equality>')),
    "hinge of two connects": File(mjcf(body('<joint name="b" type="ball"/>', "0 0 .4", name="one")
        + body("<freejoint/>", ".3 0 0", at=".2 0 .4", name="two"),
        '<equality><connect body1="one" body2="two" anchor="0 0 .4"/>'
        '<connect body1="one" body2="two" anchor=".1 .2 .4"/></equality>')),
    "parallelogram": File(mjcf('<body euler="40 0 20">'
        + body(hinge("a"), "0 0 .3", body(hinge("b"), ".5 0 0", at="0 0 .3", name="bar"))
        + body(hinge("c"), "0 0 .3", at=".5 0 0", name="arm")
        + body(hinge("d"), "0 0 .3", at=".25 0 0", name="mid")
        + "</body>",
        '<equality><connect body1="bar" body2="arm" anchor=".5 0 0"/>'
        '<connect body1="bar" body2="mid" anchor=".25 0 0"/></equality>')),
    "spatial loop of balls": File(mjcf(body(hinge("in", "0 0 1"), ".1 0 0", body(
            '<joint name="b" type="ball"/>', "0 .4 .1", at=".1 0 0", name="rod"))
        + body(hinge("out", "1 0 0"), "0 0 .1", at=".1 .4 0", name="out"),
        '<equality><connect body1="rod" body2="out" anchor="0 .4 .1"/></equality>')),
    "weld and gear": File(mjcf(
        body(hinge("a"), "0 0 .3", body('<joint name="b" type="ball"/>', ".5 0 .1",
             at="0 0 .3", name="b"))
        + '<body name="r" pos=".5 0 0"><freejoint/><geom type="box" size=".1 .2 .05"/></body>'
        + body(hinge("s1"), "0 0 .3", body(hinge("s2"), "0 0 .3", at="0 0 .3"), ".5 0 1"),
        '<equality><weld body1="b" body2="r" anchor=".1 0 .2" torquescale="0.5"/>'
        '<joint joint1="s1" joint2="s2" polycoef="0.1 .5 .2 0 0"/></equality>')),
    "connect of sites": File(mjcf('<body euler="0 30 60">'
        + body(hinge("a"), "0 0 .3", '<site name="p" pos="0 0 .3"/>')
        + body(hinge("b"), "0 0 .3", body(
            hinge("c"), "-.2 0 0", '<site name="q" pos="-.2 0 0"/>', "0 0 .3"), ".2 0 0")
        + "</body>",
        '<equality><connect site1="p" site2="q"/></equality>')),
}  # fmt: skip

#: Every kind of joint, two in one body, with springs, dampers and servos.
MIXED = mjcf(
    body('<joint name="j1" axis="0 0 1" damping="0.1"/>', "0 0 .3",
        body('<joint axis="0 1 0" stiffness="2" springref="20"/>'
        '<joint type="slide" axis="1 0 .2" armature=".1" ref="0.1"/>',
        "0.3 0 .1",
        '<body pos=".3 0 .1" euler="20 30 40">'
        '<joint type="ball" pos=".01 .02 0" damping="0.2"/>'
        '<geom type="box" size=".1 .05 .02" pos=".1 0 0"/>'
        '<body pos=".1 0 0"><geom size=".05"/></body></body>',
        "0 0 .3",),)
    + '<body pos="0 2 1"><freejoint/><geom type="box" size=".1 .2 .3" pos=".1 .1 0"/>'
    + body(hinge("h"), "0 0 .3") + "</body>",
    '<actuator><position joint="j1" kp="30" kv="2" ctrlrange="-1 1"/>'
    '<motor joint="h" gear="3" forcerange="-2 2"/></actuator>'
    '<keyframe><key qpos=".1 .2 .3 1 0 0 .2 0 2 1 1 0 .3 0 .4" ctrl="0.3 0.1"/></keyframe>',
)  # fmt: skip
ROBOTS = {
    "every joint": File(MIXED),
    "two motors at a bound joint": File(mjcf(chain(1, 'actuatorfrcrange="-88 88"', axes=("0 1 0",)),
        '<actuator><motor joint="j0"/><motor joint="j0" gear="2"/></actuator>'
        '<keyframe><key ctrl="60 20"/></keyframe>')),
    "arm above a floor": File(mjcf(
        '<geom type="plane" size="1 1 1"/>' + chain(3, 'range="-90 90" frictionloss=".1"'),
        actuated("motor", 3, 'gear="20" ctrlrange="-1 1"'),
        default="",),
        left_out=("contacts", "limits", "friction_loss"),),
    "arm held up": File(mjcf(chain(2, 'actuatorgravcomp="true"').replace(
        "<body ", '<body gravcomp="0.7" '), actuated("motor", 2)), left_out=("gravcomp",)),
    "goal that a keyframe moves": File(mjcf(
        '<body name="goal" mocap="true" pos="1 0 0"><geom size=".1"/>'
        '<body><joint/><geom size=".1" pos=".2 0 0"/></body></body>',
        '<keyframe><key qpos=".1" mpos="0 1 0" mquat=".7 .7 0 0"/></keyframe>')),
    "bob tied to a goal": File(mjcf(
        '<body name="goal" mocap="true" pos=".1 0 .6"><geom size=".01"/></body>'
        + body("<freejoint/>", "0 0 -.4", at=".1 0 .6", name="bob"),
        '<equality><connect body1="bob" body2="goal" anchor="0 0 0"/></equality>')),
}  # fmt: skip

BOX = '<geom type="box" size=".1 .1 .1"/>'
STUDENTS = {
    "spring that is no line": File(
        mjcf(body(hinge("a", more='stiffness="3 4"'), "0 0 .5")), left_out=("springs",)),
    "damper that is no line": File(
        mjcf(body(hinge("a", more='damping=".5 .1"'), "0 0 .5")), left_out=("springs",)),
    "spring that yields": File(
        mjcf(body(hinge("a", more='stiffness="3" springyield=".5"'), "0 0 .5")),
        left_out=("springs",),),
    "ball with a spring": File(
        mjcf(body('<joint type="ball" stiffness="3"/>', "0 0 .5")), left_out=("springs",)),
    "stone in water": File(
        mjcf('<body><freejoint/>' + BOX + "</body>", option='<option density="9" wind="1 0 0"/>'),
        left_out=("fluid",),),
    "pair of contact": File(mjcf('<geom name="f" type="plane" size="1 1 1"/>'
        '<body pos="0 0 1"><freejoint/><geom name="g" size=".1"/></body>',
        '<contact><pair geom1="f" geom2="g"/></contact>',),
        left_out=("contacts",),),
    "pendulum on a string": File(mjcf('<site name="top" pos="0 0 1"/>'
        + body("<freejoint/>", "0 0 .1", '<site name="end"/>'),
        '<tendon><spatial stiffness="100"><site site="top"/><site site="end"/></spatial>'
        "</tendon>",),
        left_out=("tendons",),),
    "rope of a flex": File(
        mjcf('<body><joint/><geom size=".1"/></body><flexcomp name="rope" type="grid" dim="1"'
         ' count="4 1 1" spacing=".1 .1 .1"/>'),
        refusal="flexes",),
}  # fmt: skip


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
    '<muscle joint="j0" lengthrange=".1 2"/>': ("actuators",),
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
