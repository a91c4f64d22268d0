"""A robot that cannot go on: after a touch it backs off along the way that it came; what was not seen it looks at from
elsewhere. Both only where that is free."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from brute_force import configuration, link_distances
from cases import each
from simulated_time import planning_at_once

from elastic_strips.control import Controller, DriveParams, RunState
from elastic_strips.control.local_planner import LocalPlanner
from elastic_strips.control.retreat import Retreat
from elastic_strips.control.vantage import Vantage
from elastic_strips.errors import ConfigurationError, GoalError
from elastic_strips.planning import BasePose, HandPose
from elastic_strips.scene import UNSEEN_LAYER, Box, Cylinder, Scene, Twist, UnknownMotion
from elastic_strips.scene.obstacle import LOST_LAYER, STOOD_LAYER
from elastic_strips.sim import KinematicPlant

DT = 0.01
UNSEEN = 1.2  # [m] where a bumper is pressed


def driven(robot, scene, seconds, *, bumper=lambda t, x: x > UNSEEN, params=None):
    """A controller, and the places x [m] of the base over time, of a drive onto something that nobody sees."""
    controller = Controller(
        robot, robot.home(), robot.home(x=3.0), scene(0.0), workers=planning_at_once(), params=params
    )
    plant = KinematicPlant(robot, controller.limits, seed=1)
    plant.reset(robot.space.to_coordinates(robot.home()))
    measured, places, touching = None, [], []
    for k in range(round(seconds / DT)):
        measured = plant.step(controller.step(k * DT, measured, scene(k * DT)), DT)
        felt = bumper(k * DT, plant.coordinates[0])
        measured = replace(measured, contact="the bumper is pressed" if felt else "")
        places.append(plant.coordinates[:3].copy())
        touching.append(felt)
        if controller.ended:
            break
    return controller, np.array(places), np.array(touching)


def posts_beside(robot, places):
    """Posts 1 cm beside the base at home, below its arm: at places x [m] along it, each with the side (-1 or 1)."""

    def posts(y):
        return [Cylinder(0.05, 0.4, at=(x, side * y, 0.2), name=f"post{k}") for k, (x, side) in enumerate(places)]

    near, far = 0.2, 1.0
    for _ in range(40):
        y = 0.5 * (near + far)
        apart = link_distances(robot, Scene(posts(y)), robot.home()).min()
        near, far = (y, far) if apart < 0.01 else (near, y)
    return posts(far)


def leavings(controller):
    return [event for event in controller.events if event.kind == "leaving"]


def test_it_backs_off_along_the_way_that_it_came(silvermate):
    controller, places, touching = driven(silvermate, lambda t: Scene([], time=t), 12.0)
    assert leavings(controller)
    touched = np.flatnonzero(touching)
    free = np.flatnonzero(~touching[touched[0] :])[0] + touched[0]
    assert places[free:, 0].min() <= UNSEEN
    assert places[touched[0] : free + 300, 0].min() >= UNSEEN - 0.25, "no further than it has to"
    assert np.abs(places[:, 1]).max() < 0.05, "it came along y = 0"
    assert np.diff(places[touched[0] : free, 0]).min() > -0.35 * DT, "slowly"


def test_it_does_not_go_on_touching_for_ever(silvermate):
    controller, _, touching = driven(silvermate, lambda t: Scene([], time=t), 30.0)
    began = np.flatnonzero(np.diff(touching.astype(int)) == 1)
    assert len(began) == 3
    assert controller.state is RunState.STOPPED
    assert "bumper" in controller.reason
    assert touching[-500:].all()


def test_those_who_ran_into_it_while_it_stood_do_not_keep_it_from_backing_off_later():
    """It is what the robot runs into that must not go on for ever, and its own backing off."""

    def last(*, stands):
        retreat = Retreat(SimpleNamespace(), SimpleNamespace())  # type: ignore[arg-type]
        for t in (10.0, 15.0, 20.0):
            assert not retreat.due(t, touching=True, stands=stands)
            assert not retreat.due(t + 0.5, touching=False, stands=True)
        retreat.due(31.0, touching=True, stands=True)
        return retreat.due(33.0, touching=True, stands=True)

    assert last(stands=True)
    assert not last(stands=False)


def test_it_does_not_back_off_for_ever_from_what_comes_near_while_it_stands():
    retreat = Retreat(SimpleNamespace(), SimpleNamespace())  # type: ignore[arg-type]
    backed_off = 0
    for k in range(20):
        t = 2.0 * k
        if retreat.due(t, touching=True, stands=True) or retreat.due(t + 1.5, touching=True, stands=True):
            backed_off += 1
            retreat.went(SimpleNamespace(start_time=t + 1.5, coordinates=np.zeros((2, 3))))  # type: ignore[arg-type]
        retreat.due(t + 1.8, touching=False, stands=True)
    assert backed_off == 3


@pytest.mark.parametrize("stands", [True, False])
def test_what_it_runs_into_on_its_way_from_something_else_it_has_run_into(stands):
    """So it backs off from it, also where nobody has seen it; from what came to it while it stood it does not."""
    active = SimpleNamespace(at=lambda t: None, coordinates=np.zeros((1, 3)))
    executor = SimpleNamespace(contact="", active=active, settled=False, at_rest=lambda t: t < 1.0 or t > 2.0 or stands)
    planner = SimpleNamespace(
        cramped=lambda state, scene: ("too near", 0.01),
        knows_touched=lambda state, scene: False,
        certify_leaving=lambda motion, scene: SimpleNamespace(certified=True),
    )
    planner.params = SimpleNamespace(backward=True)
    active.tail = lambda t: active
    retreat = Retreat(executor, planner)  # type: ignore[arg-type]
    for k in range(30):
        retreat._leaving = active if k >= 10 else None  # type: ignore[assignment]
        executor.contact = "the bumper is pressed" if k >= 15 else ""
        retreat.backs_off(0.1 * k, 0.1 * k, Scene([]), stuck=True)
    assert retreat.due(8.0, touching=True, stands=True, unknown=True) is not stands


@each("blind_until", [1.1, 5.0])
def test_who_has_seen_nothing_for_a_while_waits_anew_before_it_backs_off(blind_until, monkeypatch):
    """Somebody stood before its sensors; where they are now, it does not know at once."""
    went = []
    active = SimpleNamespace(at=lambda t: None, coordinates=np.zeros((1, 3)))
    executor = SimpleNamespace(contact="the bumper is pressed", active=active, settled=True, at_rest=lambda t: True)
    executor.log = lambda kind, reason: None
    executor.submit = lambda motion, certificate, **how: went.append(motion.start_time)
    planner = SimpleNamespace(
        knows_touched=lambda state, scene: True,
        certify_leaving=lambda motion, scene: SimpleNamespace(certified=True),
        params=SimpleNamespace(backward=True),
        margins=SimpleNamespace(tracking_error=0.02),
        robot=SimpleNamespace(space=SimpleNamespace(planar=True)),
    )
    retreat = Retreat(executor, planner)  # type: ignore[arg-type]
    way = np.zeros((2, 3))
    monkeypatch.setattr(retreat, "_slow", lambda rows, t, part: SimpleNamespace(start_time=t, coordinates=way))
    for t in (*np.arange(0.0, 0.75, 0.1), *np.arange(blind_until, 9.0, 0.1)):
        if not went:
            retreat.backs_off(t, t, Scene([]), stuck=True)
    assert went[0] >= (1.0 if blind_until < 1.5 else blind_until + 1.0) - 1e-6
    assert went[0] < blind_until + (0.1 if blind_until < 1.5 else 1.2)


@each("after, goes", [(-0.03, False), (-0.015, False), (0.01, True), (np.inf, True)])
def test_a_turn_that_leads_to_where_more_room_is_is_taken(after, goes, monkeypatch):
    """Also where that is not enough to plan from: the next one may be. A turn to where it stands as near is not."""
    went = []
    active = SimpleNamespace(at=lambda t: "here", coordinates=np.zeros((1, 3)))
    executor = SimpleNamespace(contact="", active=active, settled=True, at_rest=lambda t: True, log=lambda *of: None)
    executor.submit = lambda motion, certificate, **how: went.append(motion.start_time)
    planner = SimpleNamespace(
        cramped=lambda state, scene: ("near", -0.02) if state == "here" else ("near" * (after < 1.0), after),
        knows_touched=lambda state, scene: True,
        certify_leaving=lambda motion, scene: SimpleNamespace(certified=True),
        params=SimpleNamespace(backward=True),
        margins=SimpleNamespace(tracking_error=0.02),
        robot=SimpleNamespace(space=SimpleNamespace(planar=True)),
    )
    retreat = Retreat(executor, planner)  # type: ignore[arg-type]

    def slow(rows, begin, part):
        motion = SimpleNamespace(start_time=begin, end_time=begin + 1.0, coordinates=rows, at=lambda t: "there")
        return motion if len(rows) > 1 else None

    monkeypatch.setattr(retreat, "_slow", slow)
    for t in np.arange(0.0, 4.0, 0.1):
        if not went:
            retreat.backs_off(t, t, Scene([]), stuck=True)
    assert bool(went) is goes


def test_who_does_not_see_behind_it_waits_longer_until_it_backs_off(silvermate):
    """Others mostly go by then, and behind it there may be more of them."""
    waited = []
    for backward in (True, False):
        params = DriveParams(backward=backward)
        controller, _, _ = driven(silvermate, lambda t: Scene([], time=t), 10.0, params=params)
        touched = next(event.time for event in controller.events if "bumper" in event.reason)
        waited.append(leavings(controller)[0].time - touched)
    assert waited[1] > waited[0] + 1.0


def test_who_is_run_into_by_something_that_nobody_sees_stays(silvermate):
    """It may have come from behind."""
    walls = [Box((0.2, 5.0, 1.0), at=(x, 0.0, 0.5), name=f"x{x}") for x in (-2.2, 2.2)]  # they come down about it
    walls += [Box((5.0, 0.2, 1.0), at=(0.0, y, 0.5), name=f"y{y}") for y in (-2.2, 2.2)]

    def scene(t):
        return Scene(walls if t > 1.5 else [], time=t)

    controller, places, touching = driven(silvermate, scene, 14.0, bumper=lambda t, x: 7.0 < t < 13.0)
    assert places[600, 0] > 0.2
    assert np.ptp(places[600:700], axis=0).max() < 0.01
    assert not leavings(controller)
    assert np.ptp(places[touching], axis=0).max() < 0.01


def test_it_goes_on_where_what_it_touched_is_gone(silvermate):
    controller, places, _ = driven(
        silvermate, lambda t: Scene([], time=t), 60.0, bumper=lambda t, x: t < 6.0 and x > UNSEEN
    )
    assert leavings(controller)
    assert controller.state is RunState.REACHED, controller.reason
    assert places[-1, 0] == pytest.approx(3.0, abs=0.06)


@pytest.mark.parametrize("behind", [0.47, 0.55])  # [m] from the middle of its base: no way at all, and half of one
def test_it_goes_no_further_than_the_way_back_is_free(silvermate, behind):
    _, alone, _ = driven(silvermate, lambda t: Scene([], time=t), 3.0)
    wall = Box((0.2, 2.0, 1.0), at=(alone[-1, 0] - behind, 0.0, 0.5), name="wall")  # comes down behind it

    def scene(t):
        return Scene([wall] if t > 2.9 else [], time=t)

    controller, places, _ = driven(silvermate, scene, 8.0)
    rows = np.zeros((len(places), silvermate.nv))
    rows[:, :3] = places
    assert link_distances(silvermate, Scene([wall]), configuration(silvermate, rows[-1])).min() > 0.01
    if behind < 0.5:
        assert not leavings(controller)
        assert np.ptp(places[-300:, 0]) < 0.01
        assert any("back off" in event.reason and "wall" in event.reason for event in controller.events)
    else:
        assert leavings(controller)
        assert 0.03 < places[:, 0].max() - places[-1, 0] < 0.2


def test_from_what_is_too_near_it_moves_away_where_it_can(silvermate):
    """A post has come to stand 1 cm beside the rear of its base, and it has come no way."""
    post = posts_beside(silvermate, [(-0.25, 1)])
    found, places, _ = driven(
        silvermate, lambda t: Scene(post if t > 0.0 else [], time=t), 12.0, bumper=lambda t, x: False
    )
    assert leavings(found)
    assert places[-1, 0] > 0.5
    least = min(
        link_distances(silvermate, Scene(post), configuration(silvermate, [*place, *np.zeros(silvermate.nv - 3)])).min()
        for place in places[::20]
    )
    assert least > 0.006


@pytest.mark.parametrize(
    "backward, layer, backs",
    [
        (True, "far", True),
        (False, "far", False),
        (False, f"{UNSEEN_LAYER}-9-0-0", True),
        (False, f"{STOOD_LAYER}-9-0", False),
        (False, f"{LOST_LAYER}-9", False),
    ],
)
def test_from_between_what_is_too_near_it_backs_off(silvermate, backward, layer, backs):
    """Two posts 1 cm beside the front of its base: it can neither turn nor get free ahead, and has come no way. Where
    it does not see behind it, it backs off only where what was not seen is an obstacle."""
    far_away = Box((0.2, 0.2, 0.2), at=(0.0, 6.0, 0.1), name=layer)
    posts = posts_beside(silvermate, [(0.2, -1), (0.2, 1)])
    found, places, _ = driven(
        silvermate,
        lambda t: Scene([far_away, *(posts if t > 0.0 else [])], time=t),
        6.0,
        bumper=lambda t, x: False,
        params=DriveParams(backward=backward),
    )
    assert bool(leavings(found)) is backs
    assert bool(places[:, 0].min() < -0.1) is backs


def test_where_no_way_leads_it_looks_at_one_a_tick_and_then_leaves_them_for_a_while(silvermate, monkeypatch):
    """Each takes as long as a planning tick may. Once what stands about it is gone, it goes on."""
    posts = posts_beside(silvermate, [(-0.2, -1), (-0.2, 1), (0.2, -1), (0.2, 1)])
    ends = [Box((0.1, 1.0, 1.0), at=(x, 0.0, 0.5), name=f"end{x}") for x in (-0.5, 0.5)]
    looked = Counter()  # how often it is looked whether something stands too near elsewhere, where a way ends; by time

    def cramped(planner, state, scene, by=LocalPlanner.cramped):
        looked[scene.time] += bool(np.abs(state.coordinates[:3]).max() > 0.05)
        return by(planner, state, scene)

    monkeypatch.setattr(LocalPlanner, "cramped", cramped)

    def scene(t):
        return Scene([] if t == 0.0 or t > 8.0 else [*posts, *ends], time=t)

    _, places, _ = driven(silvermate, scene, 12.0, bumper=lambda t, x: False)
    assert np.ptp(places[:800], axis=0).max() < 0.01
    tried = sorted(t for t, times in looked.items() if times and t < 8.0)
    assert len(tried) > 10
    assert max(looked[t] for t in tried) == 1
    assert (np.diff(tried) > 0.4).sum() >= 4, "between the rounds"
    assert places[-1, 0] > 0.5


def test_an_emergency_stop_is_no_touch(silvermate):
    controller = Controller(
        silvermate, silvermate.home(), silvermate.home(x=3.0), Scene([]), workers=planning_at_once()
    )
    plant = KinematicPlant(silvermate, controller.limits, seed=1)
    plant.reset(silvermate.space.to_coordinates(silvermate.home()))
    measured = None
    for k in range(600):
        measured = plant.step(controller.step(k * DT, measured, Scene([])), DT)
        if k > 150:
            measured = replace(measured, contact="the bumper is pressed", emergency="the red button")
    assert not leavings(controller)
    assert controller.reference.v.any() == 0


def before_unseen(
    robot, seen, seconds, *, name=f"{UNSEEN_LAYER}-4-0-0", room=2.0, cancelled=np.inf, others=(), touches=0.0, wide=4.0
):
    """A controller, and the places of the base (K, 3), of a drive in a corridor, towards what counts as unseen until
    the base is at a place (x, y, yaw) of which ``seen`` says that it sees it. It touches something where it has
    backed off by ``touches`` [m], for a moment."""
    block = Box((0.4, wide, 1.5), at=(2.0, 0.0, 0.75), name=name)
    beside = [Box((8.0, 0.1, 1.0), at=(1.0, y, 0.5), name=f"wall{k}") for k, y in enumerate((-room, room))]
    beside += [Box((0.1, 4.0, 1.0), at=(-1.5, 0.0, 0.5), name="end"), *others]
    controller = Controller(robot, robot.home(), robot.home(x=3.0), Scene(beside), workers=planning_at_once())
    plant = KinematicPlant(robot, controller.limits, seed=1)
    plant.reset(robot.space.to_coordinates(robot.home()))
    measured, places, there, touched = None, [], True, 0.0
    for k in range(round(seconds / DT)):
        if k * DT >= cancelled and not controller.keeper.cancelled:
            controller.cancel()
        there = there and not seen(plant.coordinates[:3])
        scene = Scene([block, *beside] if there else beside, time=k * DT)
        measured = plant.step(controller.step(k * DT, measured, scene), DT)
        places.append(plant.coordinates[:3].copy())
        furthest = max(place[0] for place in places[-400:])
        touched = touched or k * DT if touches and furthest - places[-1][0] > touches else touched
        if touched and k * DT < touched + 0.3:
            measured = replace(measured, contact="the bumper is pressed")
        if controller.ended:
            break
    return controller, np.array(places)


def test_what_was_not_seen_is_looked_at_from_elsewhere(silvermate):
    """From where it was stopped it does not see it; from further back, and turned, it does."""
    controller, places = before_unseen(silvermate, lambda at: at[2] < -0.5, 60.0)
    assert controller.state is RunState.REACHED, controller.reason
    assert [event for event in controller.events if event.kind == "looking"]
    forward = np.maximum.accumulate(places[:, 0])
    assert (forward - places[:, 0]).max() > 0.4, "it backs off"
    assert (forward - places[:, 0]).max() < 0.9, "and not further than that"


def test_who_backs_off_to_look_does_not_turn_away_as_far_as_it_turned_before(silvermate):
    """It turned on the spot by 2 rad, and drove straight on: it backs off straight, and so far."""
    turn, straight = np.linspace(2.0, 0.0, 50), np.linspace(0.0, 0.4, 40)
    came = np.zeros((90, silvermate.space.nv))
    came[:50, 2], came[50:, 0] = turn, straight
    active = SimpleNamespace(coordinates=came[-1:], end_time=0.0)
    executor = SimpleNamespace(
        active=active, settled=True, at_rest=lambda t: True, estimate=came[-1], log=lambda *a: None
    )
    planner, rows = SimpleNamespace(robot=silvermate), []
    vantage = Vantage(executor, planner, lambda here: came[::-1], lambda t: None)  # type: ignore[arg-type]
    vantage._sets_out = lambda way, *rest: rows.append(way) or True  # type: ignore[method-assign]
    broken = SimpleNamespace(broken=SimpleNamespace(obstacle=f"{UNSEEN_LAYER}-4-0-0"))
    for k in range(30):
        vantage.note(0.1 * k, SimpleNamespace(accepted=False, certificate=broken, outcome=None), Scene([]), stands=True)  # type: ignore[arg-type]
        vantage.looks(0.1 * k, 0.1 * k, Scene([]), 1.0)
    assert rows[0][:, 0].min() < 0.05
    assert np.abs(rows[0][:, 2]).max() < 1.0


def test_what_was_looked_at_in_vain_is_gone_around(silvermate):
    controller, places = before_unseen(silvermate, lambda at: False, 80.0, wide=0.8)
    assert [event for event in controller.events if event.kind == "looking"]
    assert controller.state is RunState.REACHED, controller.reason
    assert np.abs(places[:, 1]).max() > 0.6


@each("moves", [True, False])
def test_what_can_be_seen_from_nowhere_else_is_gone_around(silvermate, moves):
    """Every way to where it could look from is blocked; by what moves not for good."""
    unseen = Box((0.4, 0.4, 1.0), at=(1.0, 0.0, 0.5), name=f"{UNSEEN_LAYER}-4-0-0")
    beside = Box((0.2, 0.2, 1.0), at=(0.0, 0.6, 0.5), name="beside", motion=UnknownMotion(0.2) if moves else None)
    scene, here = Scene([unseen, beside]), np.zeros((1, silvermate.space.nv))
    active = SimpleNamespace(coordinates=here, end_time=0.0)
    executor = SimpleNamespace(
        active=active, settled=True, at_rest=lambda t: True, estimate=here[0], log=lambda *a: None
    )
    planner = SimpleNamespace(
        robot=silvermate,
        timer=SimpleNamespace(easy=SimpleNamespace(full=lambda *a, **k: None)),
        certify=None,
        beginning=lambda *a: None,
    )
    vantage = Vantage(executor, planner, lambda here: here[None], lambda t: None)  # type: ignore[arg-type]
    vantage._until = 0.0  # it has looked from there before
    certificate = SimpleNamespace(broken=SimpleNamespace(obstacle=unseen.name))
    result = SimpleNamespace(accepted=False, certificate=certificate, outcome=None)
    tried: list[int] = []

    def certify(motion, scene):
        tried.append(k)
        return SimpleNamespace(certified=False, broken=SimpleNamespace(obstacle="beside"))

    planner.certify = certify
    for k in range(30):
        assert unseen.name in vantage.scene(0.1 * k, scene, no_way=False) or k > 14
        if not vantage.looks(0.1 * k, 0.1 * k, scene, 1.0):
            vantage.note(0.1 * k, result, scene, stands=True)  # type: ignore[arg-type]
    assert len(set(tried)) == 6, "turns are tried one a tick; the first is where it looks already"
    assert (unseen.name in vantage.scene(3.0, scene, no_way=False)) is moves
    assert len(vantage.scene(3.0, scene, no_way=False)) == 2
    assert unseen.name in vantage.scene(3.1, scene, no_way=True)


def kept_by(name, speed, every=4):
    """Whether a robot that moves at a speed [m/s] for 15 s, its motions refused and accepted in turn because of an
    obstacle, is to come to rest and look."""
    executor = SimpleNamespace(estimate=np.zeros(3), at_rest=lambda t: False, settled=False)
    planner = SimpleNamespace(robot=SimpleNamespace(space=SimpleNamespace(nv=3)))
    vantage = Vantage(executor, planner, None, lambda t: None)
    for k in range(150):
        executor.estimate = np.array((speed * 0.1 * k, 0.0, 0.0))
        refused = k % every == 0
        broken = SimpleNamespace(broken=SimpleNamespace(obstacle=name))
        result = SimpleNamespace(accepted=not refused, certificate=broken if refused else None, outcome=None)
        vantage.note(0.1 * k, result, Scene([]), stands=False)
    return vantage.looks(15.0, 15.0, Scene([]), 1.0)


def test_who_gets_nowhere_before_what_was_not_seen_comes_to_rest_to_look_from_elsewhere():
    """Its motions begin and are refused in turn, so that it never stands for long."""
    assert kept_by(f"{UNSEEN_LAYER}-4-0-0", 0.01)
    assert not kept_by(f"{UNSEEN_LAYER}-4-0-0", 0.2), "it gets on"
    assert kept_by("wall", 0.01), "there is nothing to look at, but another way may be"
    assert not kept_by("wall", 0.01, every=100), "its motions are not refused"


def test_who_waits_for_somebody_that_nothing_sees_does_not_go_to_look():
    """That is over soon, and behind it nothing looks."""
    assert kept_by(f"{UNSEEN_LAYER}-4-0-0", 0.0, every=1)
    assert not kept_by(f"{LOST_LAYER}-4", 0.0, every=1)


def at_a_table(robot, seen_from, seconds, *, since=0.5, asked=None, goal=None, held=(0.0, 0.0)):
    """A controller that drives to a goal 4 m ahead, of the hand by default, about which something is shown from the
    time ``since`` [s] on until the base is as near as ``seen_from`` [m]; for the hand somewhere there is something that
    was not seen, for other goals only readings are waited for. The goal is asked for at the time ``asked`` [s], on the
    way to another one; None: from the beginning. Between two times ``held`` [s] something is in the robot's base."""
    hand = (4.0, 0.0, 0.8)
    elsewhere = Box((0.4, 0.4, 0.4), at=(0.0, 5.0, 0.2), name="map-1-0" if goal else f"{UNSEEN_LAYER}-1-0-0")
    held_up = "nothing has arrived since" if goal else ""
    shown = Box((0.3, 0.3, 0.3), at=(4.0, 0.0, 0.3) if goal else hand, name="volume-1-0-0")
    goal = HandPose("hand_frame", hand) if goal is None else goal(robot)
    first = Scene([shown, elsewhere] if since <= 0.0 else [elsewhere], time=0.0, held_up=held_up)
    first_goal = goal if asked is None else robot.home(x=-1.5)
    controller = Controller(robot, robot.home(), first_goal, first, workers=planning_at_once())
    plant = KinematicPlant(robot, controller.limits, seed=1)
    plant.reset(robot.space.to_coordinates(robot.home()))
    measured, there, nearest, states = None, True, np.inf, []
    for k in range(round(seconds / DT)):
        far = float(np.hypot(*(plant.coordinates[:2] - hand[:2])))
        nearest, there = min(nearest, far), there and far > seen_from
        shows = [shown] if there and k * DT > since else []
        if held[0] <= k * DT < held[1]:
            shows.append(Box((0.3, 0.3, 0.3), at=(*plant.coordinates[:2], 0.3), name="track-7"))
        scene = Scene([*shows, elsewhere], time=k * DT, held_up=held_up)
        if asked is not None and k == round(asked / DT):
            controller.retarget(goal)
        measured = plant.step(controller.step(k * DT, measured, scene), DT)
        states.append(controller.state)
        if controller.ended:
            break
    return controller, nearest, states


def test_what_is_shown_at_a_goal_from_afar_is_looked_at_from_nearer(silvermate):
    controller, _, states = at_a_table(silvermate, 1.7, 60.0)
    assert [event for event in controller.events if event.kind == "looking"]
    assert controller.state is RunState.REACHED, controller.reason
    assert controller.reached == 1, "the place from which it looked is no goal"
    assert states.index(RunState.REACHED) == len(states) - 1


@pytest.mark.parametrize("asked", [None, 0.5, 1.5])
def test_so_is_what_is_shown_there_before_it_sets_out(silvermate, asked):
    """It is shown before there is a strip to the goal: from the beginning, and when another goal is asked for at rest
    or on the way."""
    controller, _, states = at_a_table(silvermate, 1.7, 60.0, since=-1.0, asked=asked)
    assert [event for event in controller.events if event.kind == "looking"]
    assert controller.state is RunState.REACHED, controller.reason
    assert controller.reached == 1, "where it stood at first, and looked from, are no goals"
    assert states.index(RunState.REACHED) == len(states) - 1


@pytest.mark.parametrize("goal", [lambda robot: robot.home(x=4.0), lambda robot: BasePose(4.0, 0.0)], ids=["q", "pose"])
@pytest.mark.parametrize(
    "when", [{"since": 0.5}, {"since": -1.0}, {"since": -1.0, "asked": 1.5}], ids=["on the way", "first", "retargeted"]
)
def test_so_is_what_is_shown_where_the_base_is_to_stand(silvermate, goal, when):
    """From afar nothing may see that it is gone."""
    controller, _, _ = at_a_table(silvermate, 1.7, 60.0, goal=goal, **when)
    assert [event for event in controller.events if event.kind == "looking"]
    assert controller.state is RunState.REACHED, controller.reason
    assert controller.reached == 1


def test_who_could_not_set_out_to_look_does_so_when_it_can(silvermate):
    """Somebody holds it for so long that it has tried more often than there are places to look from."""
    controller, _, _ = at_a_table(silvermate, 1.7, 70.0, goal=lambda robot: robot.home(x=4.0), held=(1.0, 34.0))
    assert [event for event in controller.events if event.kind == "looking"]
    assert controller.state is RunState.REACHED, controller.reason


def test_what_stands_there_for_good_is_waited_for(silvermate):
    controller, nearest, states = at_a_table(silvermate, 0.0, 60.0, goal=lambda robot: robot.home(x=4.0))
    assert 1 <= len([event for event in controller.events if event.kind == "looking"]) <= 3
    assert nearest > 0.8
    assert RunState.REACHED not in states
    assert not controller.goals_reached


@pytest.mark.parametrize("goal", [lambda robot: robot.home(x=4.0), lambda robot: HandPose("hand_frame", (4, 0, 0.8))])
def test_a_robot_that_starts_in_something_does_not_look(silvermate, goal):
    here = Box((0.3, 0.3, 0.3), at=(0.0, 0.0, 0.3), name="map-0-0")
    with pytest.raises(ConfigurationError):
        Controller(silvermate, silvermate.home(), goal(silvermate), Scene([here], held_up="nothing has arrived since"))


def test_what_no_motion_may_begin_beside_is_too_near(silvermate):
    """All that is kept counts, the margin beyond what it may be off its path as well."""
    start, face = silvermate.home(), Box((0.1, 3.0, 3.0), at=(2.0, 0.0, 1.5))
    with Controller(silvermate, start, silvermate.home(x=-2.0), Scene([]), workers=planning_at_once()) as controller:
        planner, state = controller.planner, controller.reference
        error, kept = planner.margins.tracking_error, planner.margins.tracking_error + planner.margins.margin
        ahead = float(link_distances(silvermate, Scene([face]), start).min())
        for off, near in ((0.5 * error, True), (0.5 * (error + kept), True), (1.2 * kept, False)):
            scene = Scene([Box((0.1, 3.0, 3.0), at=(2.0 - ahead + off, 0.0, 1.5), name="map-2-0")])
            assert bool(planner.cramped(state, scene)[0]) == near


@pytest.mark.parametrize("off", [0.009, 0.022])  # [m]: less than half of what is kept, and less than that
@pytest.mark.parametrize("until", [2.0, 99.0], ids=["goes", "stays"])
def test_a_robot_that_starts_too_near_what_its_sensors_show_begins_and_gets_away(silvermate, until, off):
    """Where that goes, or the robot can back off, it reaches its goal."""
    start = silvermate.home()
    ahead = float(link_distances(silvermate, Scene([Box((0.1, 3.0, 3.0), at=(2.0, 0.0, 1.5))]), start).min())
    shown = Box((0.1, 3.0, 3.0), at=(2.0 - ahead + off, 0.0, 1.5), name="map-2-0")
    assert 0.0 < link_distances(silvermate, Scene([shown]), start).min() < 0.024
    goal, held_up = silvermate.home(x=-2.0), "nothing has arrived since"
    first = Scene([shown], time=0.0, held_up=held_up)
    if off < 0.02:
        with pytest.raises(ConfigurationError):
            Controller(silvermate, start, goal, Scene([shown], time=0.0), workers=planning_at_once())
    controller = Controller(silvermate, start, goal, first, workers=planning_at_once())
    plant = KinematicPlant(silvermate, controller.limits, seed=1)
    plant.reset(silvermate.space.to_coordinates(start))
    measured = None
    for k in range(round(60.0 / DT)):
        scene = Scene([shown] if k * DT < until else [], time=k * DT, held_up=held_up)
        measured = plant.step(controller.step(k * DT, measured, scene), DT)
        if controller.ended:
            break
    assert controller.state is RunState.REACHED, controller.reason
    assert controller.reached == 1, "where it stood at first is no goal"


def test_a_goal_that_is_taken_in_a_known_scene_is_refused_at_once(silvermate):
    shown = Box((0.3, 0.3, 0.3), at=(4.0, 0.0, 0.8), name="box")
    with pytest.raises(GoalError):
        Controller(silvermate, silvermate.home(), HandPose("hand_frame", (4.0, 0.0, 0.8)), Scene([shown]))


def test_what_is_there_from_nearby_too_is_said_to_be_in_the_way(silvermate):
    controller, nearest, states = at_a_table(silvermate, 0.0, 80.0)
    looks = [event for event in controller.events if event.kind == "looking"]
    assert 1 <= len(looks) <= 3
    assert nearest > 0.8
    assert RunState.REACHED not in states
    assert controller.keeper.gave_up or controller.keeper.planning
    assert not controller.goals_reached


def test_who_touches_something_on_the_way_does_not_go_on(silvermate):
    controller, places = before_unseen(silvermate, lambda at: False, 12.0, touches=0.25)
    assert [event for event in controller.events if event.kind == "looking"]
    assert [event for event in controller.events if "bumper" in event.reason]
    forward = np.maximum.accumulate(places[:, 0])
    assert (forward - places[:, 0]).max() < 0.5, "all of the way back is 0.6 m"


def test_beside_somebody_it_goes_there_little_by_little(silvermate):
    """Who stands there may set out, so that all of the way could never be certified at once."""
    person = Cylinder(0.25, 1.7, at=(0.5, 1.4, 0.85), name="person", motion=Twist((0.0, 0.0, 0.0)))
    controller, places = before_unseen(silvermate, lambda at: at[2] < -0.5, 60.0, others=[person])
    assert controller.state is RunState.REACHED, controller.reason
    looking = [event for event in controller.events if event.kind == "looking"]
    assert looking
    assert (np.maximum.accumulate(places[:, 0]) - places[:, 0]).max() > 0.4


def test_it_does_not_stop_between_the_parts_of_that_way(silvermate):
    person = Cylinder(0.25, 1.7, at=(0.5, 1.4, 0.85), name="person", motion=Twist((0.0, 0.0, 0.0)))
    controller, places = before_unseen(silvermate, lambda at: at[0] < 0.0, 60.0, others=[person])
    begin = next(round(event.time / DT) for event in controller.events if event.kind == "looking")
    front = places[begin, 0]
    back = begin + int(np.argmin(places[begin : begin + 1500, 0] > front - 0.4))
    assert places[back, 0] <= front - 0.4
    speed = np.abs(np.diff(places[begin:back, 0])) / DT
    moving = np.flatnonzero(speed > 0.01)
    assert (speed[moving[0] : moving[-1]] > 0.01).all()


def test_who_is_kept_from_going_on_by_somebody_goes_back_to_let_them_by(silvermate):
    """In a narrow corridor, where neither could pass the other."""
    walls = [Box((12.0, 0.1, 1.0), at=(2.0, y, 0.5), name=f"wall{k}") for k, y in enumerate((-0.75, 0.75))]
    walls.append(Box((0.1, 1.5, 1.0), at=(-3.5, 0.0, 0.5), name="end"))
    person = Cylinder(0.25, 1.7, at=(2.2, 0.0, 0.85), name="person", motion=UnknownMotion(0.2))

    def scene(t):
        return Scene([*walls, *([person] if t < 20.0 else [])], time=t)

    controller, places, _ = driven(silvermate, scene, 40.0, bumper=lambda t, x: False)
    assert controller.state is RunState.REACHED, controller.reason
    begin = next(round(event.time / DT) for event in controller.events if event.kind == "yielding")
    assert places[begin : round(20.0 / DT), 0].min() < places[begin, 0] - 0.4


@each("moves", [True, False])
def test_only_from_what_moves_it_goes_back(silvermate, moves):
    """After it has stayed for so long; a wall does not go by."""
    thing = Box((0.4, 0.4, 1.0), at=(1.0, 0.0, 0.5), name="thing", motion=UnknownMotion(0.2) if moves else None)
    came = np.zeros((90, silvermate.space.nv))
    came[:, 0] = np.linspace(0.0, 3.0, 90)
    active = SimpleNamespace(coordinates=came[-1:], end_time=0.0)
    executor = SimpleNamespace(
        active=active, settled=True, at_rest=lambda t: True, estimate=came[-1], log=lambda *a: None
    )
    rows: list[np.ndarray] = []
    vantage = Vantage(executor, SimpleNamespace(robot=silvermate), lambda here: came[::-1], lambda t: None)  # type: ignore[arg-type]
    vantage._sets_out = lambda way, *rest: rows.append(way) or True  # type: ignore[method-assign]
    result = SimpleNamespace(
        accepted=False, outcome=None, certificate=SimpleNamespace(broken=SimpleNamespace(obstacle="thing"))
    )
    for k in (*range(240), *range(1000, 1050)):
        assert not rows or k > 95
        vantage.note(0.1 * k, result, Scene([thing]), stands=True)  # type: ignore[arg-type]
        vantage.looks(0.1 * k, 0.1 * k, Scene([thing]), 1.0)
    assert bool(rows) is moves
    if moves:
        first, second, later = (np.ptp(way[:, 0]) for way in rows)
        assert 1.3 < first < 1.7
        assert second > 2.7, "they could not get by where it stood then"
        assert 1.3 < later < 1.7, "that is over by then"


def test_what_was_seen_is_not_looked_at_from_elsewhere(silvermate):
    controller, places = before_unseen(silvermate, lambda at: False, 9.0, name="wall")
    assert not [event for event in controller.events if event.kind == "looking"]
    assert np.ptp(places[-300:, 0]) < 0.01


def test_it_looks_from_nowhere_to_where_the_way_is_not_free(silvermate):
    """Between two walls it cannot turn."""
    controller, places = before_unseen(silvermate, lambda at: False, 14.0, room=0.55)
    assert [event for event in controller.events if event.kind == "looking"]
    assert np.abs(places[:, 2]).max() < 0.3


def test_who_is_told_to_stay_does_not_go_to_look(silvermate):
    controller, places = before_unseen(silvermate, lambda at: False, 9.0, cancelled=3.5)
    assert not [event for event in controller.events if event.kind == "looking"]
    assert np.ptp(places[-300:, 0]) < 0.01
