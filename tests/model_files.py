"""Files of models as people have them: arms, hands, legs, pendulums, closed loops, URDF, flags.

Each is made of a few snippets. Nothing here is a copy of a file that exists.
"""

from __future__ import annotations

from itertools import product
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
    for turn in ("", "20 35 50", "-70 10 160")
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
    "three loops on a crank": File(mjcf('<body euler="0 20 70">'
        + body(hinge("crank"), ".1 0 .2", "".join(
            body(hinge(f"rod{k}"), ".4 0 .1", at=".1 0 .2", name=f"rod{k}") for k in range(3)))
        + "".join(
            body(hinge(f"arm{k}"), "0 0 .2", at=f".5 0 .{k}", name=f"arm{k}") for k in range(3))
        + "</body>",
        "<equality>" + "".join(
            f'<connect body1="rod{k}" body2="arm{k}" anchor=".4 0 .1"/>' for k in range(3))
        + "</equality>")),
    "legs with tarsus loops": File(mjcf(f'<body name="pelvis" pos="0 0 1">{FREE}'
        + "".join(body(hinge(f"hip{side}", "1 0 0"), "0 0 -.3",
                body(hinge(f"knee{side}"), ".1 0 -.3", at="0 0 -.3", name=f"shin{side}")
                + body(hinge(f"drive{side}"), ".1 0 0", body(
                    hinge(f"rod{side}"), "0 0 -.6", at=".1 0 0", name=f"rod{side}")),
                f"0 {y} -.05", turn=turn,)
            for side, y, turn in (("l", ".1", "10 20 30"), ("r", "-.1", "-10 5 -30")))
        + "</body>",
        "<equality>"
        + "".join(f'<connect body1="shin{s}" body2="rod{s}" anchor=".1 0 -.3"/>' for s in "lr")
        + "</equality>")),
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
    "arm with a bound of its joints": File(mjcf(chain(3, 'actuatorfrcrange="-5 5"'),
        actuated("position", 3, 'kp="900"')
        + '<keyframe><key qpos=".1 .2 -.2" ctrl="1 -1 .002"/></keyframe>')),
    "arm held up": File(mjcf(chain(2, 'actuatorgravcomp="true"').replace(
        "<body ", '<body gravcomp="0.7" '), actuated("motor", 2)), left_out=("gravcomp",)),
    "hand with coupled joints": File(mjcf(chain(3, axes=("0 1 0",)),
        '<equality><joint joint1="j1" joint2="j0" polycoef="0 .8 .1 0 0"/>'
        '<joint joint1="j2" joint2="j1" polycoef="0 .7 0 0 0"/></equality>'
        + actuated("position", 1, 'kp="2"'),)),
    "hand of muscles": File(
        mjcf(chain(2), actuated("muscle", 2, 'lengthrange="0.1 2"')), left_out=("actuators",)),
    "quadruped": File(mjcf(f'<body pos="0 0 .5">{FREE}'
        + "".join(body(hinge(f"hip{k}", "1 0 0"), "0 0 -.1",
                body(hinge(f"thigh{k}"), "0 0 -.25", body(
                    hinge(f"calf{k}", more='range="-150 -50"'), "0 0 -.25", at="0 0 -.25"),
                    "0 0 -.1"),
                f"{x} {y} 0",)
            for k, (x, y) in enumerate(product((".15", "-.15"), (".1", "-.1"))))
        + "</body>"),
        left_out=("limits",),),
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
    "pendulum": File(mjcf(body(hinge("a"), "0 0 .6"))),
    "cart and pole": File(mjcf('<body><joint name="cart" type="slide" axis="1 0 0" range="-1 1"/>'
        + BOX + body(hinge("pole"), "0 0 .6") + "</body>",
        '<actuator><motor joint="cart" gear="100" ctrlrange="-1 1" ctrllimited="true"/>'
        "</actuator>",
        '<option integrator="RK4" timestep="0.01"/>',),
        left_out=("limits",),),
    "cart in its gap": File(mjcf(
        '<body><joint type="slide" axis="1 0 0" range="-1 1"/>' + BOX + "</body>",
        option='<option><flag constraint="disable"/></option>')),
    "rotary pendulum": File(mjcf('<body pos="0 0 .5"><body pos="-.2 0 0" euler="0 90 0">'
        '<joint name="arm" axis="-1 0 0" pos="0 0 .2"/>'
        '<geom type="cylinder" size=".02 .2" mass=".4"/>'
        '<body pos="-.15 0 -.2" euler="90 90 0">'
        '<joint name="pole" axis="0 -1 0" pos="0 0 .15"/>'
        '<geom type="cylinder" size=".015 .15" mass=".2"/></body></body></body>',
        '<actuator><motor joint="arm"/></actuator>')),
    "spherical pendulum": File(mjcf(body('<joint name="b" type="ball" damping=".1"/>', "0 0 -.5"))),
    "spinning book": File(mjcf('<body><freejoint/><geom type="box" size=".1 .08 .02"/></body>',
        '<keyframe><key qpos="0 0 0 1 0 0 0" qvel="0 0 0 .02 8 .01"/></keyframe>',
        '<option gravity="0 0 0" integrator="implicitfast"/>')),
    "mass and spring": File(
        mjcf('<body><joint type="slide" stiffness="30" damping=".5"/>' + BOX + "</body>")),
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
