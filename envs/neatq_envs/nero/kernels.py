"""One tick of a field on which teams of robots sense, think, shoot and move, compiled.

The rules are OpenNERO's: robots take their turns one after the other, blue's first; each senses,
thinks, shoots, takes the damage since its last turn, and moves.
"""

from __future__ import annotations

import math

import numpy as np

from neatq_envs.nero.state import Field, Ground, NeroLaw, TeamBrains
from neatq_torch.jit import cached_njit

# Those of `state`, and the order in `scenario`; compiled functions may not fetch them there.
SENSORS_2011, SENSORS_OWN = 0, 2
FIRING_2011, FIRING_2014, FIRING_AIMED = 0, 1, 2
_DIAGONAL = math.sqrt(0.5)
RAYS = (0.0, 1.0), (_DIAGONAL, _DIAGONAL), (1.0, 0.0), (_DIAGONAL, -_DIAGONAL), (0.0, -1.0)
WALL_RANGE, WALL_NEAR = 50.0, 5.0
SIGHT_RANGE, SIGHT_NEAR = 300.0, 30.0
RADAR_BORDERS = tuple(  # cosine and sine of the left and of the right border of each in front
    tuple(round(f(math.radians(d)), 15) for d in borders for f in (math.cos, math.sin))
    for borders in ((90.0, 12.0), (18.0, -3.0), (3.0, -18.0), (-12.0, -90.0))
)
REAR_COSINE = math.cos(math.radians(87.0))
TEAM_RANGE = 15.0
AIM_TANGENT = math.tan(math.radians(2.0))
AIM_PENALTY = 20.0
TURRET_TURN_RAD = 0.1
SHOT_RANGE_2011, SHOT_RANGE_2014, SIGHT_2014 = 600.0, 200.0, 300.0
FIRE_ABOVE = 0.5
MOST_ACTIVATIONS, MOST_PUSHES = 20, 64


@cached_njit()
def play(
    field: Field,
    ground: Ground,
    law: NeroLaw,
    brains: TeamBrains,
    ticks: int,
    rng: np.random.Generator,
    film: tuple[np.ndarray, np.ndarray],
) -> int:
    """Let teams fight until one is dead or `ticks` have passed; returns the ticks that passed.

    `film`, of which arrays may have no ticks, takes poses float32 [ticks, robots, 3] and, int16
    [ticks, robots, 2], hit points left (-1: off the field) and at whom a robot shot.
    """
    for now in range(ticks):
        if tick(field, ground, law, brains, np.empty((0, 4)), rng) < 2:
            return now
        if now < len(film[0]):
            for robot in range(len(field.team)):
                left = max(law.hit_points - field.damage[robot], 0) if field.alive[robot] else -1
                film[0][now, robot] = field.pose[robot]
                film[1][now, robot, 0], film[1][now, robot, 1] = left, field.shot[robot]
    return ticks


@cached_njit()
def tick(
    field: Field,
    ground: Ground,
    law: NeroLaw,
    brains: TeamBrains,
    actions: np.ndarray,
    rng: np.random.Generator,
) -> int:
    """Let everybody take a turn; returns how many teams were on the field.

    `actions`, float64 [robots, 4], are those of robots that are moved from outside: speed (units
    per tick), turn (rad), fire, and whether friends are ignored.
    """
    correct(field, ground)
    living = find_centres(field)
    field.hits[:], field.shot[:], field.speed[:] = 0, -1, 0.0
    values = np.empty(32)
    for robot in range(len(field.team)):
        control = field.control[robot]
        if control != 2 and field.damage[robot] >= law.hit_points:
            field.alive[robot] = False
        if not field.alive[robot]:
            continue
        if control == 2:
            _shoot(field, ground, law, robot, _target(field, robot), 1.0, rng)
            field.pose[robot, 2] = _wrapped(field.pose[robot, 2] + TURRET_TURN_RAD)
            field.pending[robot] = 0
            continue
        if control == 1:
            target = _target(field, robot)
            speed, turn, fire, ignore = actions[robot]
        else:
            count, target = sense(values, field, ground, law, robot)
            speed, turn, fire, ignore = _think(brains, robot, values, count, law)
        if not field.begun[robot]:
            field.begun[robot] = True
            field.pose[robot, 2] = math.radians(math.floor(360 * rng.random())) - math.pi
            continue
        aim = _shoot(field, ground, law, robot, target, fire, rng)
        field.taken[robot] = field.pending[robot]
        field.damage[robot] += field.pending[robot]
        field.pending[robot] = 0
        field.ignores[robot] = ignore > FIRE_ABOVE
        field.speed[robot] = speed
        pose = field.pose[robot]
        pose[2] = _wrapped(pose[2] + (aim if aim != 0.0 else turn))  # turn first, then go
        pose[0] += speed * math.cos(pose[2])
        pose[1] += speed * math.sin(pose[2])
    return living


@cached_njit()
def _wrapped(angle: float) -> float:
    """The same angle in [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi


@cached_njit()
def find_centres(field: Field) -> int:
    """Write where teams are on average; returns how many live. Turrets are none."""
    count = np.zeros(len(field.centre))
    field.centre[:] = 0.0
    for robot in range(len(field.team)):
        if field.alive[robot] and field.control[robot] != 2:
            count[field.team[robot]] += 1.0
            field.centre[field.team[robot]] += field.pose[robot, :2]
    for team in range(len(count)):
        field.centre[team] /= max(count[team], 1.0)
    return int((count > 0).sum())


@cached_njit()
def sense(
    values: np.ndarray, field: Field, ground: Ground, law: NeroLaw, robot: int
) -> tuple[int, int]:
    """Write what a robot senses, each in [0, 1]; returns how many values, and its target or -1.

    2011: wall rays (distance / 50, 1 where nothing is hit), flag, enemies, friends as their mean
    place within 15 units (distance / 15, angle), target in sight. 2014: wall rays (5 / distance, 0
    where nothing is hit), flag, enemies, friends, a dead input. Own: wall rays as in 2014, flag,
    enemies, friends by sectors, target, hit points left, under fire.
    """
    pose = field.pose[robot]
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    values[:] = 0.0
    _sense_walls(values, pose, cosine, sine, ground, law.sensors == SENSORS_2011)
    if not math.isnan(field.flag[0]):
        dx, dy = field.flag[0] - pose[0], field.flag[1] - pose[1]
        _add_radar(values, 5, cosine * dx + sine * dy, cosine * dy - sine * dx)
    target = _sense_others(values, field, robot, cosine, sine, law.sensors == SENSORS_OWN)
    values[5:20] = np.minimum(values[5:20], 1.0)
    if law.sensors == SENSORS_OWN:
        values[20] = 1.0 if target >= 0 else 0.0
        values[21] = max(1.0 - field.damage[robot] / law.hit_points, 0.0)
        values[22] = min(1.0, field.taken[robot] + field.pending[robot])
        return 23, target
    if not field.ignores[robot]:
        _sense_friends(values, field, robot, cosine, sine, law.sensors == SENSORS_2011)
    if law.sensors == SENSORS_2011:
        values[17] = 1.0 if target >= 0 else 0.0
    return 18, target


@cached_njit()
def _sense_others(
    values: np.ndarray, field: Field, robot: int, cosine: float, sine: float, friends: bool
) -> int:
    """Add enemies to their radar and, if asked, friends to theirs; returns the target or -1.

    That is the enemy within 2 degrees of the heading that is nearest, if one aims well.
    """
    x, y, team = field.pose[robot, 0], field.pose[robot, 1], field.team[robot]
    target, least = -1, math.inf
    for other in range(len(field.team)):
        friend = field.team[other] == team
        if not field.alive[other] or (friend and not friends) or other == robot:
            continue
        dx, dy = field.pose[other, 0] - x, field.pose[other, 1] - y
        along, across = cosine * dx + sine * dy, cosine * dy - sine * dx
        squared = along * along + across * across
        if not friend and along >= 0.0 and abs(across) <= AIM_TANGENT * along:
            cost = math.sqrt(squared) / math.cos(AIM_PENALTY * math.atan2(across, along))
            if cost < least:
                target, least = other, cost
        if squared <= SIGHT_RANGE * SIGHT_RANGE:
            _add_radar(values, 15 if friend else 10, along, across)
    return target


@cached_njit()
def _add_radar(values: np.ndarray, first: int, along: float, across: float) -> None:
    """Add what is seen, `along` the heading and `across` it to the left, to its sectors."""
    distance = math.sqrt(along * along + across * across)
    if distance > SIGHT_RANGE:
        return
    near = SIGHT_NEAR / max(distance, SIGHT_NEAR)
    if along >= 0.0:
        for sector in range(4):
            left_cosine, left_sine, right_cosine, right_sine = RADAR_BORDERS[sector]
            not_left = across * left_cosine <= along * left_sine
            if not_left and across * right_cosine >= along * right_sine:
                values[first + sector] += near
    if along <= REAR_COSINE * distance:
        values[first + 4] += near


@cached_njit()
def _sense_friends(
    values: np.ndarray, field: Field, robot: int, cosine: float, sine: float, of_2011: bool
) -> None:
    """Write how far and where the mean of the team is, in 2014 of those within 15 units."""
    pose, team, count = field.pose[robot], field.team[robot], 1.0
    dx, dy = field.centre[team, 0] - pose[0], field.centre[team, 1] - pose[1]
    for other in range(0 if of_2011 else len(field.team)):
        dx, dy = (0.0, 0.0) if other == 0 else (dx, dy)
        x, y = field.pose[other, 0] - pose[0], field.pose[other, 1] - pose[1]
        near = x * x + y * y <= TEAM_RANGE * TEAM_RANGE and other != robot
        if near and field.alive[other] and field.team[other] == team:
            dx, dy, count = dx + x, dy + y, count + 1.0
    dx, dy = dx / count, dy / count
    distance = math.sqrt(dx * dx + dy * dy)
    if distance <= TEAM_RANGE:
        angle = math.atan2(cosine * dy - sine * dx, cosine * dx + sine * dy)
        values[15] = distance / TEAM_RANGE if of_2011 else 1.0 - distance / TEAM_RANGE
        values[16] = (angle + math.pi) / (2 * math.pi) if distance > 1e-9 else 0.5


@cached_njit()
def _target(field: Field, robot: int) -> int:
    """At whom a robot shoots, -1: at nobody; see `_sense_others`."""
    cosine, sine = math.cos(field.pose[robot, 2]), math.sin(field.pose[robot, 2])
    return _sense_others(np.empty(32), field, robot, cosine, sine, False)


@cached_njit()
def _shoot(
    field: Field,
    ground: Ground,
    law: NeroLaw,
    robot: int,
    target: int,
    fire: float,
    rng: np.random.Generator,
) -> float:
    """Shoot by the law; returns the angle by which aiming turns the robot, 0: by none."""
    if law.firing == FIRING_2014:
        return _shoot_2014(field, ground, robot, fire, rng)
    if target < 0 or (law.firing == FIRING_AIMED and fire < FIRE_ABOVE):
        return 0.0
    field.shot[robot] = target
    way = field.pose[target] - field.pose[robot]
    distance = math.hypot(way[0], way[1])
    if law.firing == FIRING_AIMED:
        hit = rng.random() * SIGHT_2014 > distance
    else:
        miss = (SHOT_RANGE_2011 - distance) / SHOT_RANGE_2011 / 2
        first, second = rng.random(), rng.random()
        hit = first > miss and second > miss
    if hit and sees(field, ground, robot, target):
        field.pending[target] += 1
        field.hits[robot] += 1
    return 0.0


@cached_njit()
def _shoot_2014(
    field: Field, ground: Ground, robot: int, fire: float, rng: np.random.Generator
) -> float:
    """Shoot at the nearest enemy in sight, or turn to it by the full angle."""
    target, least, angle = -1, SIGHT_2014, 0.0
    for other in range(len(field.team)):
        if fire >= FIRE_ABOVE and field.team[other] != field.team[robot] and field.alive[other]:
            way = field.pose[other] - field.pose[robot]
            distance = math.hypot(way[0], way[1])
            if distance < least and sees(field, ground, robot, other):
                target, least = other, distance
                angle = _wrapped(math.atan2(way[1], way[0]) - field.pose[robot, 2])
    if target >= 0 and abs(angle) <= math.radians(2.0):
        field.shot[robot], angle = target, 0.0
        if rng.random() < (SHOT_RANGE_2014 - least) / (2 * SHOT_RANGE_2014):
            field.pending[target] += 1
            field.hits[robot] += 1
    return angle


@cached_njit()
def sees(field: Field, ground: Ground, robot: int, other: int) -> bool:
    """Whether no wall stands between two robots."""
    x, y = field.pose[robot, 0], field.pose[robot, 1]
    way_x, way_y = field.pose[other, 0] - x, field.pose[other, 1] - y
    for wall in range(len(ground.boxes)):
        box = ground.boxes[wall]
        if _meets(x - box[0], y - box[1], way_x, way_y, box) <= 1.0:
            return False
    return True


@cached_njit()
def _sense_walls(
    values: np.ndarray, pose: np.ndarray, cosine: float, sine: float, ground: Ground, of_2011: bool
) -> None:
    """Write how near walls are along the five rays."""
    left, right, bottom, top = ground.inner
    for ray in range(5):
        along, up = RAYS[ray]
        way_x, way_y = cosine * along - sine * up, sine * along + cosine * up
        distance = min(_leaves(pose[0], way_x, left, right), _leaves(pose[1], way_y, bottom, top))
        for wall in range(len(ground.boxes)):
            box = ground.boxes[wall]
            dx, dy = pose[0] - box[0], pose[1] - box[1]
            if dx * dx + dy * dy <= (WALL_RANGE + box[6]) ** 2:
                distance = min(distance, _meets(dx, dy, way_x, way_y, box))
        if of_2011:
            values[ray] = min(distance / WALL_RANGE, 1.0)
        elif distance <= WALL_RANGE:
            values[ray] = WALL_NEAR / max(distance, WALL_NEAR)


@cached_njit()
def _leaves(place: float, way: float, low: float, high: float) -> float:
    """How far along a ray the slab low..high is left."""
    gap = high - place if way > 0 else place - low
    return max(gap, 0.0) / max(abs(way), 1e-12)


@cached_njit()
def _meets(dx: float, dy: float, way_x: float, way_y: float, box: np.ndarray) -> float:
    """How far along a way, (dx, dy) from its centre on, a box is met (Kay & Kajiya 1986)."""
    enter, leave = 0.0, math.inf
    for axis in range(2):
        cosine, sine = (box[2], box[3]) if axis == 0 else (-box[3], box[2])
        place, way = cosine * dx + sine * dy, cosine * way_x + sine * way_y
        if abs(way) < 1e-12:
            if abs(place) > box[4 + axis]:
                return math.inf
            continue
        near, far = (-box[4 + axis] - place) / way, (box[4 + axis] - place) / way
        enter, leave = max(enter, min(near, far)), min(leave, max(near, far))
    return enter if enter <= leave else math.inf


@cached_njit()
def look(field: Field, ground: Ground, law: NeroLaw, robots: int, observed: np.ndarray) -> None:
    """Write what the first robots sense, float32 [robots, observations]; the dead sense 0."""
    values = np.empty(32)
    for robot in range(robots):
        sense(values, field, ground, law, robot)
        for index in range(observed.shape[1]):
            observed[robot, index] = values[index] if field.alive[robot] else 0.0


@cached_njit()
def correct(field: Field, ground: Ground) -> None:
    """Push the robots' ellipses out of walls and borders, the nearest way: they slide along."""
    wide, high = ground.radius
    low_x, high_x, low_y, high_y = ground.inner
    for robot in range(len(field.team)):
        pose, going = field.pose[robot], field.alive[robot] and field.control[robot] != 2
        for _ in range(MOST_PUSHES if going else 0):
            from_x, from_y = pose[0], pose[1]
            for wall in range(len(ground.boxes)):
                box = ground.boxes[wall]
                reach = box[6] + max(wide, high)
                if (pose[0] - box[0]) ** 2 + (pose[1] - box[1]) ** 2 <= reach * reach:
                    x, y = _pushed_out(pose[0] / wide, pose[1] / high, ground.corners[wall])
                    pose[0], pose[1] = x * wide, y * high
            pose[0] = min(max(pose[0], low_x + wide), high_x - wide)
            pose[1] = min(max(pose[1], low_y + high), high_y - high)
            if math.hypot(pose[0] - from_x, pose[1] - from_y) < 1e-9:
                break


@cached_njit()
def _pushed_out(x: float, y: float, corners: np.ndarray) -> tuple[float, float]:
    """Where a circle of radius 1 goes that meets a convex polygon [4, 2], counter-clockwise."""
    inside, least, near_x, near_y, out_x, out_y = True, math.inf, x, y, 0.0, 0.0
    for side in range(4):
        from_x, from_y = corners[side]
        way_x, way_y = corners[(side + 1) % 4, 0] - from_x, corners[(side + 1) % 4, 1] - from_y
        along = (x - from_x) * way_x + (y - from_y) * way_y
        share = min(max(along / (way_x * way_x + way_y * way_y), 0.0), 1.0)
        foot_x, foot_y = from_x + share * way_x, from_y + share * way_y
        distance = math.hypot(x - foot_x, y - foot_y)
        inside = inside and way_x * (y - from_y) - way_y * (x - from_x) >= 0.0
        if distance < least:
            least, near_x, near_y = distance, foot_x, foot_y
            length = math.hypot(way_x, way_y)
            out_x, out_y = way_y / length, -way_x / length
    if least >= 1.0 and not inside:
        return x, y
    if least < 1e-9:
        return near_x + out_x, near_y + out_y
    scale = (-1.0 if inside else 1.0) / least
    return near_x + (x - near_x) * scale, near_y + (y - near_y) * scale


@cached_njit()
def _think(
    brains: TeamBrains, robot: int, values: np.ndarray, count: int, law: NeroLaw
) -> tuple[float, float, float, float]:
    """Activate a network once; returns speed, turn, fire and whether friends are ignored."""
    first = brains.node[robot]
    for index in range(count):
        brains.value[first + index] = values[index]
    brains.value[first + count] = brains.bias[robot]
    outputs = brains.outputs[brains.output[robot] : brains.output[robot + 1]]
    for _ in range(MOST_ACTIVATIONS):
        _activate_once(brains, robot, first + count + 1)
        waiting = False
        for output in outputs:
            waiting = waiting or not brains.fired[output]
        if not (waiting and brains.silent[robot]):
            break
    candidates = brains.candidates[robot]
    actions = len(outputs) // candidates - (candidates > 1)
    best = np.argmax(brains.value[outputs[-candidates:]]) if candidates > 1 else 0
    read = np.zeros(4)
    for action in range(actions):
        read[action] = min(max(brains.value[outputs[best * actions + action]], 0.0), 1.0)
    speed, turn = (2 * read[0] - 1) * law.max_speed, (2 * read[1] - 1) * law.max_turn_rad
    return speed, turn, read[2], read[3]


@cached_njit()
def _activate_once(brains: TeamBrains, robot: int, begin: int) -> None:
    """Let values go on by one link each, or, where links are not late, through the network."""
    end, silent = brains.node[robot + 1], brains.silent[robot]
    for node in range(begin, end):
        total, reached = 0.0, not silent or brains.active[node]
        for link in range(brains.link[node], brains.link[node + 1]):
            source = brains.source[link]
            value = brains.before[source] if brains.late[link] else brains.value[source]
            total += brains.weight[link] * value
            reached = reached or source < begin or brains.active[source]
        brains.active[node] = reached
        if reached:
            brains.value[node] = _activated(total, brains.activation[node])
            brains.fired[node] = True
    brains.before[brains.node[robot] : end] = brains.value[brains.node[robot] : end]


@cached_njit()
def _activated(total: float, activation: int) -> float:
    if activation == 1 or activation == 2:
        return 1.0 / (1.0 + math.exp(-total * (4.9 if activation == 2 else 1.0)))
    rectified = max(total, 0.0) if activation == 4 else total
    return math.tanh(total) if activation == 3 else rectified
