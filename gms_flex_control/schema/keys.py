# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The parameters of robot, controller and nodes, and what a name in any file stands for."""

from dataclasses import replace

from gms_flex_control.effects import registry
from gms_flex_control.errors import ConfigError, did_you_mean, ParameterError
from gms_flex_control.hardware.limits import Limits, UNLIMITED
from gms_flex_control.hardware.mapping import Reading
from gms_flex_control.params.arm import ARM_KINDS, ArmParams, AXES, STANDARD_GRAVITY
from gms_flex_control.params.gains import COMPENSATIONS, ControllerParams
from gms_flex_control.params.key import below, Key, keys_of, LARGEST_STATE, SMALLEST
from gms_flex_control.params.robot import (
    EncoderParams,
    FrictionParams,
    LARGEST_SD,
    LEAST_SD,
    StribeckParams,
    UNCERTAIN,
    WHOLE_ARM,
)

EXPERIMENTS = ('constant_velocity', 'break_away', 'presliding', 'sliding')
TRAJECTORIES = ('hold', 'sinusoid', 'polynomial', 'via_points', 'velocity_levels',
                'torque_levels', 'sliding', 'fourier')

MODE = Key('mode', 'paced by the clock, or each sample waits for its command', default='realtime',
           choices=('realtime', 'lockstep'))
PRIORITY = Key('realtime_priority', 'of the whole process, SCHED_FIFO of Linux where it is '
               'permitted; 0 for none', '', 0, 0, 99)
RECORDERS = Key('recorders', 'answer no joint state before so many record what is published', '',
                0, 0, 100)
CONTROLLER_NODE = (  # beyond robot and gains
    MODE, PRIORITY, RECORDERS,
    Key('reference_timeout', 'age of a reference that is still followed', 's', 0.1, 1e-3, 10.0),
    Key('reference_hold', 'how long a lost motion is braked and held', 's', 2.0, 0.0, 1e7),
    Key('reference_relax', 'in what time the torque then goes to zero', 's', 1.0, 0.0, 1e4),
    Key('resume_time', 'of the way from the robot to a reference that is elsewhere', 's', 2.0,
        1e-3, 1e4),
    Key('state_every', 'publish ~/state and ~/blocks at every n-th tick', '', 1, 1, 1000000))
_PLANT = (
    Key('rate', 'joint states per second', 'Hz', 500.0, 1.0, 10000.0),
    Key('substeps', 'integration steps per joint state', '', 20, 1, 10000),
    Key('command_timeout', 'age of a command that still acts; then zero torque', 's', 0.02, 1e-4,
        10.0),
    Key('seed', 'of the encoder noise', '', 0, 0, 2**31 - 1),
    Key('duration', 'simulated time after which the node ends; 0 is never', 's', 0.0, 0.0, 1e7),
    Key('wait_for_subscribers', 'begin only when so many listen to the joint states', '', 0, 0,
        100),
    Key('clock_rate', 'most /clock messages per simulated second, lockstep only', 'Hz', 100.0,
        0.1, 10000.0))
_SAFETY = (
    Key('backend', 'simulated robot, or bridge to a real one', default='sim',
        choices=('sim', 'bridge')),
    Key('silence_timeout', 'without a command for so long: zero torque and FAULT', 's', 0.035,
        0.002, 1.0),
    Key('emergency_stop_topic', 'std_msgs/Bool, true is pressed', default='emergency_stop'),
    Key('hold_services', 'called by ~/enable so that reference and controller begin where the '
        'robot is; empty for none', default=('trajectory/reset', 'cascade_controller/reset')))
# below bridge
_BRIDGE = (
    Key('state_topics', 'joint states of the robot, one or several topics',
        default=('robot/joint_states',)),
    Key('command_topic', 'efforts for the robot', default='robot/effort_controller/commands'),
    Key('command_type', 'Float64MultiArray on command_topic, JointState on joint_command_topic, '
        'or both', default='array', choices=('array', 'joint_state', 'both')),
    Key('joint_command_topic', 'efforts as JointState', default='robot/joint_commands'),
    Key('command_order', "our joint names in the order of the effort controller's; empty for "
        'that of joints', default=()),
    Key('state_timeout', 'without joint states for so long: zero torque and FAULT', 's', 0.03,
        0.002, 1.0),
    Key('skew', 'readings further apart make no state', 's', 0.01, 1e-5, 1.0),
    Key('velocity_cutoff', 'low-pass of velocities that the robot does not send', 'Hz', 50.0, 0.1,
        1e4),
    Key('guardian', 'start a process that sends zero efforts when the bridge dies or freezes',
        default=True),
    Key('device', 'module:Class, or entry point, of a robot without ros2_control; then the '
        'topics above are not used', default=''),
    Key('device_options', 'for the device, each name=value', default=()))
# below mapping.<joint>.effort
_EFFORT = (
    Key('name', "name in the robot's joint states and commands; '' is that of the motor side, or "
        'of the link of a rigid joint', default=''),
    Key('sign', '1, or -1 if positive effort drives the joint backward', '', 1.0, -1.0, 1.0),
    Key('torque_constant', 'torque per unit of effort; 1 if efforts are torques', 'N m per unit',
        1.0, SMALLEST, UNLIMITED),
    Key('side', 'whether that torque is the one at the joint or at the motor shaft',
        default='joint', choices=('motor', 'joint')),
    Key('ratio', 'gear ratio by which a torque at the motor shaft becomes one at the joint', '',
        1.0, SMALLEST, 1e6))
# below trajectory
_TRAJECTORY = (
    Key('type', 'kind of reference', default='hold', choices=TRAJECTORIES, live=True),
    Key('autostart', 'start at the first joint state', default=False),
    Key('approach_time', 'duration of the way to its beginning', 's', 2.0, 1e-3, 1e4, live=True),
    Key('ramp_time', 'ramp of a sinusoid; settling of the others', 's', 3.0, 1e-3, 1e4, live=True),
    Key('move_time', 'duration of a move between rests', 's', 5.0, 1e-3, 1e4, live=True),
    Key('hold_time', 'duration of a rest', 's', 5.0, 0.0, 1e4, live=True),
    Key('repeats', 'cycles of polynomial and Fourier series', '', 1, 1, 100000, live=True),
    Key('duration', 'of sliding', 's', 5.0, 1e-3, 1e5, live=True),
    Key('modulation', 'relative variation of sliding', '', 0.5, 0.0, 0.99, live=True),
    Key('rate', 'mean slope between torque levels', 'N m/s', 0.02, 1e-9, 1e6, live=True),
    Key('durations', 'of the velocity levels', 's', (1.0,), 1e-3, 1e5, live=True))
_PLAUSIBLE = -LARGEST_STATE, LARGEST_STATE
# below trajectory.<joint>
_MOTION = (
    Key('amplitude', 'of sinusoid and polynomial', 'rad', 1.0, *_PLAUSIBLE, live=True),
    Key('period', 'of sinusoid and sliding', 's', 6.0, 1e-3, 1e4, live=True),
    Key('phase', 'of the sinusoid', 'rad', 0.0, *_PLAUSIBLE, live=True),
    Key('velocity', 'of sliding', 'rad/s', 0.1, *_PLAUSIBLE, live=True),
    Key('velocities', 'velocity levels', 'rad/s', (0.0,), *_PLAUSIBLE, live=True),
    Key('offset', 'where velocity levels, sliding and Fourier series begin', 'rad', 0.0,
        *_PLAUSIBLE, live=True),
    Key('levels', 'torque levels, from zero and back to zero', 'N m', (0.0,), live=True),
    Key('bias', 'added to torque levels, against gravity', 'N m', 0.0, live=True),
    Key('travel', 'this far moved ends torque levels, 0 for never', 'rad', 0.0, 0.0, live=True),
    Key('points', 'via points, the first included', 'rad', (0.0, 1.0, 0.0),
        *_PLAUSIBLE, live=True),
    Key('sine', 'amplitudes of the harmonics of a Fourier series', 'rad', (0.0,), *_PLAUSIBLE,
        live=True),
    Key('cosine', 'the same, a quarter of a wave earlier', 'rad', (0.0,), *_PLAUSIBLE,
        live=True))
# below identification
_EXPERIMENT = (
    Key('experiments', f"which of {', '.join(EXPERIMENTS)}, in this order", default=EXPERIMENTS),
    Key('joints', 'joints to identify, in this order; empty is all', default=()),
    Key('compensation', 'friction compensation of the controller meanwhile', default='gms',
        choices=COMPENSATIONS),
    Key('margin', 'between planned angles and the range of a joint', 'rad', 0.1, 0.0, 10.0),
    Key('rest_time', 'rest after each step', 's', 0.3, 0.0, 60.0),
    Key('relax_time', 'for the springs to unload before a torque step', 's', 0.6, 0.3, 60.0),
    Key('settle_time', 'shortest change of velocity', 's', 0.3, 0.01, 60.0),
    Key('speeds', 'constant velocities per direction', '', 10, 2, 1000),
    Key('repeats', 'of each constant velocity', '', 3, 1, 1000),
    Key('dwell_time', 'at each constant velocity, less where the range ends', 's', 1.0, 0.05, 1e4),
    Key('longest_dwell', 'at the slowest', 's', 10.0, 0.05, 1e4),
    Key('counts', 'least travel at constant velocity, in encoder counts', '', 20.0, 0.0, 1e6),
    Key('lead_in', 'sliding before a slow velocity, so that every block slips', 'rad', 0.35, 0.0,
        100.0),
    Key('lead_in_speed', 'how fast that is', 'rad/s', 0.3, 1e-4, 100.0),
    Key('torque_rate', 'mean slope of torques, in F_s per second', '1/s', 0.4, 1e-4, 100.0),
    Key('break_away_level', 'largest torque, in F_s', '', 1.3, 1.0, 3.0),
    Key('break_away_repeats', 'per direction', '', 3, 1, 1000),
    Key('break_away_travel', 'this far moved is broken away', 'rad', 0.03, 1e-5, 10.0),
    Key('presliding_levels', 'amplitudes, in F_s', '', (0.3, 0.5, 0.65, 0.8), 0.01, 0.99),
    Key('presliding_travel', 'so far a motion is no longer presliding: the step ends', 'rad',
        0.05, 1e-5, 10.0),
    Key('presliding_places', 'at which each amplitude is applied, a shift apart', '', 3, 1, 1000),
    Key('presliding_cycles', 'at each place', '', 1, 1, 1000),
    Key('minor_loop', 'amplitude of the loops nested in a cycle, 0 for none', '', 0.5, 0.0, 0.95),
    Key('shift', 'move between places, so that the angle within an encoder count differs', 'rad',
        0.0501, 0.0, 1.0),
    Key('sliding_speeds', 'mean velocities, in v_s', '', (1.0, 2.0, 5.0), 0.01, 1000.0),
    Key('sliding_duration', 'less where the range ends', 's', 10.0, 0.1, 1e4),
    Key('sliding_period', 'of the variation', 's', 0.8, 0.01, 100.0),
    Key('modulation', 'relative variation', '', 0.7, 0.0, 0.99))
# below identification.<joint>
_IDENTIFIED = (
    Key('lower', 'least angle allowed', 'rad', -1.0),
    Key('upper', 'largest angle allowed', 'rad', 1.0),
    Key('velocity', 'largest speed allowed', 'rad/s', 1.0, SMALLEST),
    Key('acceleration', 'largest planned', 'rad/s^2', 2.0, SMALLEST),
    Key('torque', 'largest motor torque allowed; 0 takes the torque limit of the controller',
        'N m', 0.0, 0.0),
    Key('slowest', 'constant velocity; 0 takes a third of v_s', 'rad/s', 0.0, 0.0),
    Key('fastest', 'constant velocity; 0 takes 0.9 of the limit', 'rad/s', 0.0, 0.0),
    Key('static', 'expected F_s; 0 takes that of the robot file', 'N m', 0.0, 0.0),
    Key('stribeck_velocity', 'expected v_s; 0 takes that of the robot file', 'rad/s', 0.0, 0.0))
IDENTIFICATION_NODE = (MODE, *below('identification', (  # beyond robot, gains and experiment
    Key('bag', 'recording to be made', default='identification'),
    Key('autostart', 'begin as soon as all nodes are there', default=True),
    Key('fit', 'fit the friction when the last step is finished, into a folder beside the bag',
        default=True),
    Key('trajectory_node', 'name of the trajectory node', default='trajectory'),
    Key('controller_node', 'name of the controller node', default='cascade_controller'),
    Key('plant_node', 'name of the plant; in lockstep it pauses while results are computed',
        default='plant'),
    Key('patience', 'for the other nodes to come', 's', 60.0, 0.1, 1e5),
    Key('silence', 'of states or commands that ends the experiment', 's', 3.0, 0.1, 1e4))))


def plant_node_keys(joints) -> tuple[Key, ...]:
    """Return the keys of the plant node beyond the robot."""
    start = Key('initial', 'link angle at the start', 'rad', 0.0, *_PLAUSIBLE)
    return (MODE, *_PLANT, *(replace(start, name=f'initial.{joint}') for joint in joints))


def safety_keys(joints) -> tuple[Key, ...]:
    """Return the keys of the plant node that hold for simulator and bridge."""
    return (PRIORITY, *_SAFETY, *_of_each(joints, 'limits', keys_of(Limits)))


def bridge_keys(joints) -> tuple[Key, ...]:
    """Return the keys of the bridge beyond those of `safety_keys`."""
    keys = list(below('bridge', _BRIDGE))
    for joint in joints:
        for side, names in (('link', 'joints'), ('motor', 'motors')):
            name = Key('name', "name in the robot's joint states; '' is the name in " + names,
                       default='')
            keys += below(f'mapping.{joint}.{side}', (name, *keys_of(Reading)))
        keys += below(f'mapping.{joint}.effort', _EFFORT)
    return tuple(keys)


def trajectory_keys(joints) -> tuple[Key, ...]:
    """Return the keys of the trajectory node."""
    return (MODE, PRIORITY, RECORDERS, *below('trajectory', _TRAJECTORY),
            *_of_each(joints, 'trajectory', _MOTION))


def identification_keys(joints) -> tuple[Key, ...]:
    """Return the keys of the identification experiment."""
    return (*below('identification', _EXPERIMENT),
            *_of_each(joints, 'identification', _IDENTIFIED))


def _of_each(joints, prefix, keys):
    """Return keys below ``prefix.<joint>`` of each joint."""
    return tuple(key for joint in joints for key in below(f'{prefix}.{joint}', keys))


DOWN = (0.0, 0.0, -STANDARD_GRAVITY)  # gravity where the base is level [m/s^2]
_FREE = {'effects': 'effects.<joint>.<effect>.<parameter>',  # whose keys depend on the file
         'uncertainty': 'uncertainty.<joint>.<kind>'}
_PER_JOINT = ('arm', 'friction', 'gains', 'identification', 'limits', 'mapping', 'trajectory')

# of each joint, below arm.<joint>, of a URDF
_OF_URDF = (
    Key('mass_factor', 'mass of the link over that of the URDF', '1', 1.0, SMALLEST),
    Key('inertia_factor', 'inertia of the link about its centre of mass over that of the URDF',
        '1', 1.0, SMALLEST),
    Key('inertial', 'instead of the URDF, in the frame at the joint whose z is its axis: mass, '
        'centre of mass x y z, inertia about it xx xy xz yy yz zz', 'kg, m, kg m^2', (),
        kind='double_array'))
_ROBOT = (
    Key('joints', 'names of the link sides, from the base outwards', kind='string_array'),
    Key('motors', "names of the motor sides; '' for a rigid joint", default=()),
    Key('identified_from', 'recordings by which `gms_flex identify` found the friction: name, '
        'duration; along these `gms_flex discrepancy` may identify it anew', default=()),
    Key('arm.kind', 'chain in a plane, axes without effect on each other, or the chain of a URDF',
        default='planar', choices=ARM_KINDS),
    Key('arm.axes', 'whether decoupled axes turn or slide', default='rotary', choices=AXES),
    Key('arm.gravity', 'gravity along -y of the plane; 0 if it is horizontal', 'm/s^2', 0.0),
    Key('arm.gravity_vector', 'gravity x, y, z in the frame of the base, of kind urdf', 'm/s^2',
        DOWN),
    Key('arm.urdf', 'URDF file with the links, relative to the robot file', default=''),
    Key('arm.base', 'link of the URDF where the chain begins; default: the root', default=''),
    Key('arm.tip', 'link of the URDF where the chain ends; what moves beyond or beside it is '
        'held at 0', default=''))
COMPENSATION = Key('compensation', 'friction compensation', default='gms', choices=COMPENSATIONS,
                   live=True)


def robot_keys(joints) -> tuple[Key, ...]:
    """Return the keys of a robot file for the given joint names."""
    keys = [*_ROBOT, *below('encoder', keys_of(EncoderParams))]
    for joint in joints:
        keys += [*below(f'arm.{joint}', (*keys_of(ArmParams), *_OF_URDF)),
                 *(key for way in ('forward', 'backward')
                   for key in below(f'friction.{joint}.{way}', keys_of(StribeckParams))),
                 *below(f'friction.{joint}', keys_of(FrictionParams))]
    return tuple(keys)


def controller_keys(joints) -> tuple[Key, ...]:
    """Return the keys of a controller file for the given joint names."""
    gains = keys_of(ControllerParams)
    return (COMPENSATION, *(key for joint in joints for key in below(f'gains.{joint}', gains)))


def all_keys(joints) -> dict[str, Key]:
    """Return the keys of all nodes by name, for one file shared by all."""
    keys = (*robot_keys(joints), *controller_keys(joints), *CONTROLLER_NODE,
            *plant_node_keys(joints), *trajectory_keys(joints), *identification_keys(joints),
            *IDENTIFICATION_NODE, *safety_keys(joints), *bridge_keys(joints))
    return {key.name: key for key in keys}


def _effect_key(name, joints):
    """Return the key ``effects.<joint>.<effect>.<parameter>``; ConfigError names the nearest."""
    joint, effect, parameter = _parts(name, _FREE['effects'], joints)
    try:
        kind = registry.find(effect)
    except ParameterError as error:
        raise ConfigError(f'{name}: {error}') from error
    if kind.whole_arm != (joint == WHOLE_ARM):
        place = f'effects.{WHOLE_ARM}' if kind.whole_arm else 'effects.<joint>'
        raise ConfigError(f'{name}: {effect} belongs under {place}')
    known = {entry.name: entry for entry in kind.parameters}
    if parameter not in known:
        raise ConfigError(f'{name}: {effect} has no parameter {parameter!r}'
                          f'{did_you_mean(parameter, known)}')
    entry = known[parameter]
    return Key(name, entry.description, entry.unit, lower=entry.lower, upper=entry.upper)


def _parts(name, form, joints):
    """Return the parts of a key behind its first; refuse another form, and an unknown joint."""
    _, *parts = name.split('.')
    if len(parts) != form.count('.'):
        raise ConfigError(f'{name} must have the form {form}')
    if parts[0] not in (*joints, WHOLE_ARM):
        raise ConfigError(f'{name}: unknown joint {parts[0]!r}'
                          f'{did_you_mean(parts[0], (*joints, WHOLE_ARM))}')
    return parts


def _uncertainty_key(name, joints):
    """Return the key of a standard deviation, ``uncertainty.<joint>.<kind>``."""
    _, kind = _parts(name, _FREE['uncertainty'], joints)
    if kind not in UNCERTAIN:
        raise ConfigError(f'{name}: unknown kind of parameter {kind!r}'
                          f'{did_you_mean(kind, UNCERTAIN)}')
    return Key(name, f'relative standard deviation: {UNCERTAIN[kind].description}', '1',
               lower=LEAST_SD, upper=LARGEST_SD)


def known_keys(names, joints) -> dict[str, Key]:
    """Return the key of every name of a file (dict); ConfigError at the first unknown one."""
    known = all_keys(joints)
    keys = {}
    for name in names:
        if name.startswith('effects.'):
            keys[name] = _effect_key(name, joints)
        elif name.startswith('uncertainty.'):
            keys[name] = _uncertainty_key(name, joints)
        elif name in known:
            keys[name] = known[name]
        else:
            raise ConfigError(f'{name} is not a known parameter{_nearest(name, known, joints)}')
    return keys


def _nearest(name, known, joints):
    parts = name.split('.')
    if name in _FREE:
        return f': {_FREE[name]} stands under it'
    below = [key for key in known if key.startswith(f'{name}.')]
    if below:
        return f': {below[0]} and others stand under it'
    if len(parts) > 2 and parts[0] in _PER_JOINT and parts[1] not in joints:
        return f'; unknown joint {parts[1]!r}{did_you_mean(parts[1], joints)}'
    return did_you_mean(name, [key for key in known if key.count('.') == name.count('.')])
