"""Mistakes that people make in experiment files: each is one line with the line of the file, the key and the remedy."""

import re
from pathlib import Path

import pytest

from support.experiment_files import load_data, refusal

GOOD = """\
schema: 2
name: mine
description: ""
seed: 3
plant: integral
observer: {mode: fusion}
attentive: false
stiffness: 5.0
max_duration: 600.0
reactions:
  - on: {limb: left_arm, min_torque: 2.0}
    say: Ouch
    leds: {group: FaceLeds, colour: [1.0, 0.0, 0.0], duration: 0.5}
    do: hold
    pause: 0.3
  - {on: {link: RForeArm, lasting: 1.0}, play: wave, at_most: 2}
contacts:
  - kind: push
    joint: LShoulderRoll
    link: LBicep
    xyz: [0.16, 0.0, 0.0]
    force: [0.0, 10.0, 0.0]
    start: 1.0
    duration: 0.5
    step: listen
  - kind: random_pushes
    joints: [RElbowRoll]
    times: [0.5]
    duration: [0.3, 0.6]
    degrees: [2.0, 6.0]
    points: {RElbowRoll: {link: RForeArm, xyz: [0.14, 0.0, 0.0]}}
steps:
  - name: stand
    posture: Stand
    duration: 1.0
    hold: 0.5
  - joints: {HeadYaw: 0.3}
    hands: {LHand: 0.5}
    duration: 2.0
    until: reached
    tolerance: 0.02
    timeout: 3.0
  - position: {link: l_wrist, root: torso, target: [0.3, 0.2, 0.1]}
    look_at: {link: l_wrist}
    base: {x: 0.1, heading: 0.5}
    duration: 2.0
  - name: listen
    wait: {joint: LShoulderRoll, timeout: 5.0, on_timeout: stop}
  - repeat:
      times: 3
      until: {limb: head, touches: 2, within: 2.0}
      steps:
        - {hold: 1.0}
  - branch:
      timeout: 5.0
      deciding: 0.2
      cases:
        - {on: {limb: left_arm, kind: collision}, steps: [{say: Hard, hold: 1.0}]}
        - {on: {limb: left_arm}, steps: []}
      otherwise: [{play: stretch}]
  - setpoints:
      joints: [HeadYaw]
      range: 0.5
      period: 3.0
      count: 2
      base: {linear: 0.1, angular: 0.2, share: 0.5}
  - {cue: over}
"""


def test_the_good_one_loads(tmp_path: Path) -> None:
    assert load_data(tmp_path, GOOD).name == "mine"


NUMBER, WHOLE, TEXT = (
    "must be a number, got ",
    "must be a whole number, got ",
    "must be a text, got ",
)
LIST, MAPPING = "must be a list, got ", "must be a mapping of keys to values, got "

# What stands in the good file, what is written in its place, the line and key that the message names, and what it says.
BAD = [
    # the top
    ("schema: 2", "schema: 1", 1, "schema", "a file of an old form, 'schema: 1'; the form is"),
    ("schema: 2", "version: 1", 1, "version", "a file of an old form, 'version: 1'"),
    ("schema: 2", "schema: two", 1, "schema", 'must be 2, got "two"'),
    ("schema: 2", "schema: 2.5", 1, "schema", "must be 2, got 2.5"),
    ("schema: 2\n", "", 0, "schema", "is missing"),
    ("name: mine", "name: 3", 2, "name", f"{TEXT}3"),
    ("name: mine", "name:", 2, "name", f"{TEXT}null"),
    ("name: mine", 'name: "a\\tb"', 2, "name", "must be a text of one line without control characters"),
    ("name: mine", f"name: {'x' * 200}", 2, "name", "must be a text of at most 80 letters"),
    ("name: mine", "nmae: mine", 2, "nmae", "(did you mean name?"),
    ("name: mine", "name: mine\nname: yours", 3, None, "key 'name' is given twice"),
    ('description: ""', "description: [a]", 3, "description", f"{TEXT}a list"),
    ("seed: 3", "seed: -1", 4, "seed", "must be 0 or more, got -1"),
    ("seed: 3", "seed: 1.5", 4, "seed", f"{WHOLE}1.5"),
    ("seed: 3", "seed: true", 4, "seed", f"{WHOLE}true"),
    ("plant: integral", "plant: true", 5, "plant", f"{TEXT}true"),
    ("plant: integral", "plant: integrl", 5, "plant", "unknown plant 'integrl' (did you mean integral"),
    ("plant: integral", "world: tabel", 5, "world", "unknown world 'tabel' (did you mean table"),
    ("plant: integral", "plants: integral", 5, "plants", "(did you mean plant?"),
    ("observer: {mode: fusion}", "observer: fusion", 6, "observer", f'{MAPPING}"fusion"'),
    ("mode: fusion", "mode: 3", 6, "observer.mode", f"{TEXT}3"),
    ("mode: fusion", "modes: fusion", 6, "observer.modes", "(did you mean mode"),
    ("attentive: false", "attentive: 1", 7, "attentive", "must be true or false, got 1"),
    ("attentive: false", "attentive: no", 7, "attentive", 'must be true or false, got "no"'),
    ("stiffness: 5.0", "stiffness: 0", 8, "stiffness", "must be above 0, got 0"),
    ("stiffness: 5.0", "stiffness: stiff", 8, "stiffness", f'{NUMBER}"stiff"'),
    ("max_duration: 600.0", "max_duration: 10", 9, "max_duration", "may take 40 s, with all repetitions and timeouts"),
    ("max_duration: 600.0", "max_duration: 1e9", 9, "max_duration", "must be 86400 or less"),
    ("max_duration: 600.0", "longest: 600.0", 9, "longest", "possible: attentive, contacts"),
    ("max_duration: 600.0", "max_duration: .inf", 9, "max_duration", "must be a finite number, got inf"),
    # reactions
    ("limb: left_arm, min", "limb: lef_arm, min", 11, "reactions.0.on.limb", "(did you mean left_arm"),
    ("limb: left_arm, min", "limb: [], min", 11, "reactions.0.on.limb", "a list needs at least one name"),
    ("limb: left_arm, min", "limb: 3, min", 11, "reactions.0.on.limb", "or a list of names is needed, got 3"),
    ("min_torque: 2.0", "min_torque: hard", 11, "reactions.0.on.min_torque", f'{NUMBER}"hard"'),
    ("min_torque: 2.0", "min_torque: -2", 11, "reactions.0.on.min_torque", "must be 0 or more, got -2"),
    ("min_torque: 2.0", "min_torque: 200", 11, "reactions.0.on.min_torque", "must be 100 or less"),
    ("min_torque: 2.0", "min_intensity: 2.0", 11, "reactions.0.on.min_intensity", "(did you mean min_intensity_deg"),
    ("min_torque: 2.0", "lasting: 2.0", 11, "reactions.0", "a reflex answers at once: 'lasting' and"),
    ("say: Ouch", 'say: ""', 12, "reactions.0.say", "must not be empty"),
    ("say: Ouch", "say: [Ouch]", 12, "reactions.0.say", f"{TEXT}a list"),
    ("[1.0, 0.0, 0.0]", "[1.0, 0.0]", 13, "reactions.0.leds.colour", "needs at least 3 entries"),
    ("[1.0, 0.0, 0.0]", "[1.0, 0.0, 0.0, 0.0]", 13, "reactions.0.leds.colour", "takes at most 3, has 4"),
    ("[1.0, 0.0, 0.0]", "[255, 0, 0]", 13, "reactions.0.leds.colour.0", "must be 1 or less, got 255"),
    ("[1.0, 0.0, 0.0]", "red", 13, "reactions.0.leds.colour", f'{LIST}"red"'),
    ("colour: [1.0", "color: [1.0", 13, "reactions.0.leds.color", "(did you mean colour?"),
    ("group: FaceLeds", "group: 3", 13, "reactions.0.leds.group", f"{TEXT}3"),
    ("duration: 0.5}\n    do", "duration: 100}\n    do", 13, "reactions.0.leds.duration", "must be 60 or less"),
    ("    do: hold\n    pause: 0.3\n", "    pause: 0.3\n", 14, "reactions.0.pause", "possible: at_most, cue, do"),
    ("link: RForeArm, lasting", "link: RForeAm, lasting", 16, "reactions.1.on.link", "(did you mean RForeArm"),
    ("link: RForeArm, lasting", "link: RForeArm, limb: head, lasting", 16, "reactions.1.on", "different limbs"),
    ("lasting: 1.0", "lasting: .nan", 16, "reactions.1.on.lasting", "must be a finite number, got nan"),
    ("play: wave", "play: wvae", 16, "reactions.1.play", "unknown experiment 'wvae' (did you mean wave"),
    ("play: wave", "play: mine.yaml", 16, "reactions.1.play", "'mine.yaml' would be played in itself without end"),
    ("at_most: 2", "at_most: 0", 16, "reactions.1.at_most", "must be 1 or more"),
    ("at_most: 2", "at_most: 1.5", 16, "reactions.1.at_most", f"{WHOLE}1.5"),
    # contacts
    ("kind: push\n", "kind: shove\n", 18, "contacts.0", "unknown kind 'shove'"),
    ("kind: push\n    joint", "joint", 18, "contacts.0", "no 'kind' (possible: grab, joint_push, push"),
    ("joint: LShoulderRoll\n", "joint: LShoulderRol\n", 19, "contacts.0.joint", "(did you mean LShoulderRoll"),
    ("link: LBicep", "link: LBicp", 20, "contacts.0.link", "(did you mean LBicep"),
    ("xyz: [0.16, 0.0, 0.0]", "xyz: [0.16, 0.0]", 21, "contacts.0.xyz", "needs at least 3 entries"),
    ("xyz: [0.16, 0.0, 0.0]", "xyz: [0.16, left, 0.0]", 21, "contacts.0.xyz.1", f'{NUMBER}"left"'),
    ("force: [0.0, 10.0, 0.0]", "force: 10.0", 22, "contacts.0.force", f"{LIST}10.0"),
    ("force: [0.0, 10.0, 0.0]", "force: [0, 0, 0]", 18, "contacts.0", "'force' must be longer than 0"),
    ("force: [0.0, 10.0, 0.0]", "force: [0, 2000, 0]", 18, "contacts.0", "1000 N at most, not 2000"),
    ("start: 1.0", "start: -1", 23, "contacts.0.start", "must be 0 or more, got -1"),
    ("start: 1.0", "begin: 1.0", 23, "contacts.0.begin", "possible: start"),
    ("duration: 0.5\n    step", "duration: 0\n    step", 24, "contacts.0.duration", "must be above 0, got 0"),
    ("step: listen", "step: 3", 25, "contacts.0.step", f"{TEXT}3"),
    ("joints: [RElbowRoll]", "joints: [RElbowRol]", 26, "contacts.1", "'points' has no entry for joint RElbowRol"),
    ("times: [0.5]", "times: 0.5", 28, "contacts.1.times", f"{LIST}0.5"),
    ("times: [0.5]", "times: [2.5]", 28, "contacts.1.times", "may last until 3.1 s, beyond the next goal"),
    ("duration: [0.3, 0.6]", "duration: [0.6, 0.3]", 26, "contacts.1", "'duration': the lower bound 0.6 is above"),
    ("degrees: [2.0, 6.0]", "degrees: [2.0]", 30, "contacts.1.degrees", "needs at least 2 entries"),
    ("degrees: [2.0, 6.0]", "degrees: [2.0, 100]", 30, "contacts.1.degrees.1", "must be 90 or less"),
    ("points: {RElbowRoll:", "points: {RElbow:", 26, "contacts.1", "'points' has no entry for joint RElbowRoll"),
    ("link: RForeArm, xyz", "lnk: RForeArm, xyz", 31, "contacts.1.points.RElbowRoll.lnk", "(did you mean link?"),
    # steps of motion
    ("posture: Stand", "posture: Stnd", 34, "steps.0.posture", "unknown posture 'Stnd' (did you mean Stand"),
    ("posture: Stand", "posture: 3", 34, "steps.0.posture", f"{TEXT}3"),
    ("    duration: 1.0\n    hold", "    duration: -1\n    hold", 35, "steps.0.duration", "must be 0.001 or more"),
    ("    duration: 1.0\n    hold", "    duration: .nan\n    hold", 35, "steps.0.duration", "must be a finite number"),
    ("    duration: 1.0\n    hold", "    duration: fast\n    hold", 35, "steps.0.duration", f'{NUMBER}"fast"'),
    ("    duration: 1.0\n    hold", "    duration: 1 s\n    hold", 35, "steps.0.duration", f'{NUMBER}"1 s"'),
    ("    duration: 1.0\n    hold", "    duration: true\n    hold", 35, "steps.0.duration", f"{NUMBER}true"),
    ("    duration: 1.0\n    hold: 0.5", "    duration: 1.0\n    hold:", 36, "steps.0.hold", f"{NUMBER}null"),
    ("    duration: 1.0\n    hold", "    duration: [1.0]\n    hold", 35, "steps.0.duration", f"{NUMBER}a list"),
    ("    duration: 1.0\n    hold", "    time: 1.0\n    hold", 35, "steps.0.time", "unknown key"),
    ("    duration: 1.0\n    hold: 0.5", "    hold: 0", 33, "steps.0", "a step takes time: give 'duration'"),
    ("HeadYaw: 0.3", "HeadYaw: 30", 37, "steps.1.joints.HeadYaw", "30 rad lies outside -2.08567 to 2.08567 rad"),
    ("HeadYaw: 0.3", "HeadYaw: left", 37, "steps.1.joints.HeadYaw", f'{NUMBER}"left"'),
    ("HeadYaw: 0.3", "HeadYw: 0.3", 37, "steps.1.joints.HeadYw", "(did you mean HeadYaw"),
    ("joints: {HeadYaw: 0.3}", "joints: [HeadYaw]", 37, "steps.1.joints", f"{MAPPING}a list"),
    ("LHand: 0.5", "LHand: 50", 38, "steps.1.hands.LHand", "50 lies outside 0 to 1"),
    ("LHand: 0.5", "left: 0.5", 38, "steps.1.hands.left", "unknown hand 'left' (possible: LHand, RHand)"),
    ("until: reached", "until: arrived", 40, "steps.1.until", "must be 'reached', got \"arrived\""),
    ("    until: reached\n", "", 37, "steps.1", "'tolerance' and 'timeout' belong to 'until: reached'"),
    ("tolerance: 0.02", "tolerance: 0", 41, "steps.1.tolerance", "must be above 0"),
    ("timeout: 3.0\n  -", "timeout: 1.0\n  -", 37, "steps.1", "'timeout' 1 s ends before 'duration', 2 s"),
    ("link: l_wrist, root", "link: left_wrist, root", 43, "steps.2.position.link", "unknown link 'left_wrist'"),
    ("root: torso", "root: world", 43, "steps.2.position.root", "unknown link 'world'"),
    ("target: [0.3, 0.2, 0.1]", "target: [0.3, 0.2, 1000]", 43, "steps.2.position.target.2", "must be 100 or less"),
    ("target: [0.3, 0.2, 0.1]", "goal: [0.3, 0.2, 0.1]", 43, "steps.2.position.goal", "possible: target"),
    ("look_at: {link: l_wrist}", "look_at: {}", 44, "steps.2.look_at", "look_at gives either 'point' or 'link'"),
    ("look_at: {link: l_wrist}", "look_at: l_wrist", 44, "steps.2.look_at", f'{MAPPING}"l_wrist"'),
    ("x: 0.1", "x: far", 45, "steps.2.base.x", f'{NUMBER}"far"'),
    ("heading: 0.5", "heading: 90", 45, "steps.2.base.heading", "must be 6.28319 or less, got 90"),
    ("base: {x: 0.1, heading: 0.5}", "base: {}", 45, "steps.2.base", "base gives 'x', 'y' or 'heading'"),
    # waits, loops, branches
    ("joint: LShoulderRoll, timeout", "joint: LShoulder, timeout", 48, "steps.3.wait.joint", "unknown joint"),
    ("timeout: 5.0, on_timeout", "on_timeout", 48, "steps.3.wait.timeout", "is missing"),
    ("on_timeout: stop", "on_timeout: end", 48, "steps.3.wait.on_timeout", "must be 'continue' or 'stop'"),
    ("on_timeout: stop", "otherwise: stop", 48, "steps.3.wait.otherwise", "unknown key"),
    ("wait: {joint: LShoulderRoll, timeout: 5.0, on_timeout: stop}", "wait: 5", 48, "steps.3.wait", f"{MAPPING}5"),
    ("wait: {joint", "wait: {for: contact, joint", 48, "steps.3.wait.for", "unknown key"),
    ("      times: 3\n", "", 49, "steps.4.repeat.times", "is missing"),
    ("times: 3", "times: forever", 50, "steps.4.repeat.times", f'{WHOLE}"forever"'),
    ("times: 3", "times: 0", 50, "steps.4.repeat.times", "must be 1 or more"),
    ("times: 3", "times: 5000", 50, "steps.4.repeat.times", "must be 1000 or less"),
    ("touches: 2, within: 2.0", "touches: 2", 51, "steps.4.repeat.until", "'touches' above 1 and 'within' [s] belong"),
    ("within: 2.0", "within: 0", 51, "steps.4.repeat.until.within", "must be above 0, got 0"),
    ("limb: head", "limb: tail", 51, "steps.4.repeat.until.limb", "unknown limb 'tail'"),
    ("touches: 2, within", "touches: two, within", 51, "steps.4.repeat.until.touches", f'{WHOLE}"two"'),
    ("steps:\n        - {hold: 1.0}", "steps: []", 52, "steps.4.repeat.steps", "needs at least one step"),
    ("steps:\n        - {hold: 1.0}", "steps: {hold: 1.0}", 52, "steps.4.repeat.steps", f"{LIST}a mapping"),
    ("        - {hold: 1.0}", "        - hold", 53, "steps.4.repeat.steps.0", "a step is a mapping of keys to values"),
    ("        - {hold: 1.0}", "        - {hold: -1.0}", 53, "steps.4.repeat.steps.0.hold", "must be 0 or more"),
    ("repeat:\n", "reepat:\n", 49, "steps.4.reepat", "(did you mean repeat"),
    ("      timeout: 5.0\n", "", 54, "steps.5.branch.timeout", "is missing"),
    ("deciding: 0.2", "deciding: soon", 56, "steps.5.branch.deciding", f'{NUMBER}"soon"'),
    ("kind: collision}", "kind: rebound}", 58, "steps.5.branch.cases.0.on", "a rebound is no touch"),
    ("kind: collision}", "kind: hit}", 58, "steps.5.branch.cases.0.on.kind", "must be 'contact', 'collision'"),
    ("limb: left_arm, kind: collision}", "}", 59, "steps.5.branch.cases.1", "can never be chosen: 'cases.0'"),
    ("{on: {limb: left_arm}, steps", "{steps", 59, "steps.5.branch.cases.1.on", "is missing"),
    ("[{play: stretch}]", "[{play: mine.yaml}]", 60, "steps.5.branch.otherwise.0.play", "in itself"),
    ("otherwise: [{play: stretch}]", "otherwise: {play: stretch}", 60, "steps.5.branch.otherwise", f"{LIST}a mapping"),
    ("[{play: stretch}]", "[{play: away.yaml}]", 60, "steps.5.branch.otherwise.0.play", "no file"),
    # random goals
    ("joints: [HeadYaw]\n", "joints: [HeadYw]\n", 62, "steps.6.setpoints.joints", "(did you mean HeadYaw"),
    ("joints: [HeadYaw]\n", "joints: HeadYaw\n", 62, "steps.6.setpoints.joints", f'{LIST}"HeadYaw"'),
    ("joints: [HeadYaw]\n", "joints: []\n", 62, "steps.6.setpoints.joints", "needs at least one joint"),
    ("range: 0.5", "range: 50", 63, "steps.6.setpoints.range", "must be 1 or less, got 50"),
    ("period: 3.0", "period: 0", 64, "steps.6.setpoints.period", "must be above 0"),
    ("count: 2", "count: many", 65, "steps.6.setpoints.count", f'{WHOLE}"many"'),
    ("count: 2", "counts: 2", 65, "steps.6.setpoints.counts", "(did you mean count?"),
    ("linear: 0.1", "linear: 1", 66, "steps.6.setpoints.base.linear", "1 m/s lies outside 0 to 0.35 m/s"),
    ("  - setpoints:\n", "  - holds:\n", 64, "steps.6.holds.period", "(possible: hold, move)"),
    ("angular: 0.2", "angular: 5", 66, "steps.6.setpoints.base.angular", "5 rad/s lies outside 0 to 1 rad/s"),
    (", share: 0.5", "", 66, "steps.6.setpoints.base.share", "is missing"),
    ("cue: over", "cue: 1", 67, "steps.7.cue", f"{TEXT}1"),
    ("cue: over", "cue: over, duration: 1, play: wave", 67, "steps.7.cue", "(possible: name, play)"),
    # no YAML
    ("  - {cue: over}", "  - {cue: over", 68, None, "expected"),
    ("  - {cue: over}", " - {cue: over}", 67, None, "expected"),
    ("  - {cue: over}", "  - {cue: over, cue: done}", 67, None, "key 'cue' is given twice"),
    ("  - {cue: over}", "\t- {cue: over}", 67, None, "cannot start any token"),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "line", "key", "reason"), BAD)
def test_a_mistake_is_one_line(
    tmp_path: Path, old: str, new: str, line: int, key: str | None, reason: str
) -> None:
    assert GOOD.count(old) == 1, "the case is of one place"
    said = refusal(tmp_path, GOOD.replace(old, new))
    if key is not None:
        assert re.match(rf"( line \d+)?: (unknown )?key '{re.escape(key)}'[ :]", said), said
    assert said.startswith(f" line {line}:" if line else ": "), said
    assert reason in said


# What stands in the good file, what is written in its place, and how many mistakes there are.
SEVERAL = [
    ("    duration: 1.0\n    hold", "    duration: -1\n    hold", 1),
    ("    duration: 1.0\n    hold", "    duration: .nan\n    hold", 1),
    ("    duration: 1.0\n    hold: 0.5", "    duration: -1\n    hold: x", 2),
    ("force: [0.0, 10.0, 0.0]", "forc: [0.0, 10.0, 0.0]", 1),
    ("force: [0.0, 10.0, 0.0]", "degrees: 3.0", 2),
    ("xyz: [0.16, 0.0, 0.0]", "xyz: []", 1),
    ("xyz: [0.16, 0.0, 0.0]", "xyz: [a, b, c]", 3),
    ("colour: [1.0, 0.0, 0.0]", "color: [2.0]", 1),
    ("seed: 3", "seed: x\nspeed: 3", 2),
    ("        - {hold: 1.0}", "        - {hold: a}\n        - {hold: b}\n        - 3", 3),
    ("steps:\n        - {hold: 1.0}", "steps: []", 1),
]


@pytest.mark.parametrize(("old", "new", "count"), SEVERAL)
def test_mistakes_are_counted(tmp_path: Path, old: str, new: str, count: int) -> None:
    assert GOOD.count(old) == 1
    said = refusal(tmp_path, GOOD.replace(old, new))
    assert said.endswith(f" (and {count - 1} more)") is (count > 1), said


def test_there_is_a_case_for_every_key() -> None:
    """The reflexes (``do``) are left out: only ``pepper_driver`` knows which there are."""
    named = {word for _, _, _, key, _ in BAD for word in (key or "").split(".")}
    assert set(re.findall(r"(\w+):", GOOD)) - named == {"do"}
    assert len(BAD) >= 90
