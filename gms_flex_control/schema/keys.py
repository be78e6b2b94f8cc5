# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Every parameter of every node: name, type, unit, range, default and what it means."""

from gms_flex_control.params.arm import AXES, KINDS
from gms_flex_control.params.gains import COMPENSATIONS
from gms_flex_control.schema.bridge_keys import bridge_keys, PRIORITY, safety_keys
from gms_flex_control.schema.key import Key, SMALLEST

EXPERIMENTS = ('constant_velocity', 'break_away', 'presliding', 'sliding')
TRAJECTORIES = ('hold', 'sinusoid', 'polynomial', 'via_points', 'constant_velocity',
                'velocity_levels', 'torque_ramp', 'torque_levels', 'sliding')
MODES = ('realtime', 'lockstep')
STANDARD_GRAVITY = (0.0, 0.0, -9.80665)  # conventional value (3rd CGPM, 1901) [m/s^2]


def _arm_keys(joint):
    prefix = f'arm.{joint}.'
    return (
        Key(prefix + 'mass', 'double', 'mass of the link', 'kg', 0.0, 0.0),
        Key(prefix + 'length', 'double', 'distance to the next joint', 'm', 0.0, 0.0),
        Key(prefix + 'com', 'double', 'centre of mass from the joint', 'm', 0.0),
        Key(prefix + 'inertia', 'double', 'inertia about the centre of mass; of a decoupled axis '
            'the whole inertia', 'kg m^2', lower=0.0, unless=('arm.kind', 'urdf')),
        Key(prefix + 'motor_inertia', 'double', 'motor inertia reflected to the joint',
            'kg m^2', lower=0.0),
        Key(prefix + 'stiffness', 'double', 'stiffness of the joint; .inf for a rigid one',
            'N m/rad', lower=SMALLEST),
        Key(prefix + 'damping', 'double', 'damping of the joint', 'N m s/rad', 0.0, 0.0),
        Key(prefix + 'offset', 'double', 'angle of the link where the joint reads 0, from the x '
            'axis or the link before it', 'rad', 0.0),
        Key(prefix + 'mass_factor', 'double', 'mass of the link over that of the URDF', '1', 1.0,
            SMALLEST),
        Key(prefix + 'inertia_factor', 'double', 'inertia of the link about its centre of mass '
            'over that of the URDF', '1', 1.0, SMALLEST),
    )


def _friction_keys(joint):
    keys = []
    for direction in ('forward', 'backward'):
        prefix = f'friction.{joint}.{direction}.'
        keys += [
            Key(prefix + 'static', 'double', 'static friction F_s', 'N m', lower=SMALLEST),
            Key(prefix + 'coulomb', 'double', 'Coulomb friction F_c', 'N m', lower=SMALLEST),
            Key(prefix + 'velocity', 'double', 'Stribeck velocity v_s', 'rad/s', lower=SMALLEST),
            Key(prefix + 'viscous', 'double', 'viscous friction sigma_2', 'N m s/rad', lower=0.0)]
    prefix = f'friction.{joint}.'
    keys += [
        Key(prefix + 'stiffness', 'double_array', 'stiffness k_i of each block', 'N m/rad',
            lower=0.0),
        Key(prefix + 'weight', 'double_array', 'share alpha_i of each block, sum 1', '1',
            lower=0.0),
        Key(prefix + 'attraction', 'double', 'C of the slipping blocks', 'N m/s', lower=SMALLEST)]
    return keys


def robot_keys(joints):
    """Return the keys of a robot file for the given joint names."""
    keys = [
        Key('joints', 'string_array', 'names of the link sides, from the base outwards'),
        Key('motors', 'string_array', "names of the motor sides; '' for a rigid joint",
            default=()),
        Key('arm.kind', 'string', 'chain in a plane, axes without effect on each other, or the '
            'chain of a URDF',
            default='planar', choices=KINDS),
        Key('arm.axes', 'string', 'whether decoupled axes turn or slide', default='rotary',
            choices=AXES),
        Key('arm.gravity', 'double', 'gravity along -y of the plane; 0 if it is horizontal',
            'm/s^2', 0.0),
        Key('arm.gravity_vector', 'double_array', 'gravity x, y, z in the frame of the base, of '
            'kind urdf', 'm/s^2', STANDARD_GRAVITY),
        Key('arm.urdf', 'string', 'URDF file with the links, relative to the robot file',
            default=''),
        Key('arm.base', 'string', 'link of the URDF where the chain begins; default: the root',
            default=''),
        Key('arm.tip', 'string', 'link of the URDF where the chain ends; what moves beyond or '
            'beside it is held at 0', default=''),
        Key('encoder.counts', 'double', 'counts per revolution; 0 is ideal', '1', 0.0, 0.0),
        Key('encoder.noise', 'double', 'standard deviation before counting', 'rad', 0.0, 0.0),
        Key('encoder.velocity_cutoff', 'double', 'low-pass on the differenced angle; 0 reads '
            'the true velocity', 'Hz', 0.0, 0.0)]
    for joint in joints:
        keys += [*_arm_keys(joint), *_friction_keys(joint)]
    return tuple(keys)


def controller_keys(joints):
    """Return the keys of a controller file for the given joint names."""
    keys = [Key('compensation', 'string', 'friction compensation', default='gms',
                choices=COMPENSATIONS, live=True)]
    for joint in joints:
        prefix = f'gains.{joint}.'
        keys += [
            Key(prefix + 'kd_link', 'double', 'K_D1 of the link law', 'N m s/rad', lower=0.0,
                upper=1e9, live=True),
            Key(prefix + 'lambda_link', 'double', 'Lambda_1 of the link law', '1/s', lower=0.0,
                upper=1e4, live=True),
            Key(prefix + 'kd_motor', 'double', 'K_D2 of the motor law', 'N m s/rad', lower=0.0,
                upper=1e9, live=True),
            Key(prefix + 'lambda_motor', 'double', 'Lambda_2 of the motor law', '1/s', lower=0.0,
                upper=1e4, live=True),
            Key(prefix + 'observer_gain', 'double', 'k_e, correction of slipping blocks by the '
                'tracking error', '', 1.0, 0.0, 1e6, live=True),
            Key(prefix + 'sign_slope', 'double', 'k_v of tanh(k_v v), gms_paper and stribeck only',
                's/rad', 50.0, 1e-3, 1e6, live=True),
            Key(prefix + 'filter_bandwidth', 'double', 'command filter on the friction '
                'estimate, all modes but none and gms_paper', 'rad/s', 100.0, 1e-3, 1e5,
                live=True),
            Key(prefix + 'torque_limit', 'double', 'largest motor torque', 'N m', lower=0.0,
                upper=1e9, live=True)]
    return tuple(keys)


MODE = Key('mode', 'string', 'paced by the clock, or each sample waits for its command',
           default='realtime', choices=MODES)


def controller_node_keys():
    """Return the keys of the controller node beyond robot and gains."""
    return (
        MODE, PRIORITY,
        Key('reference_timeout', 'double', 'age of a reference that is still followed', 's', 0.1,
            1e-3, 10.0),
        Key('reference_hold', 'double', 'how long a lost motion is braked and held', 's', 2.0,
            0.0, 1e7),
        Key('reference_relax', 'double', 'in what time the torque then goes to zero', 's', 1.0,
            0.0, 1e4),
        Key('resume_time', 'double', 'of the way from the robot to a reference that is '
            'elsewhere', 's', 2.0, 1e-3, 1e4),
        Key('state_every', 'integer', 'publish ~/state and ~/blocks at every n-th tick', '', 1, 1,
            1000000))


def plant_node_keys(joints):
    """Return the keys of the plant node beyond the robot."""
    keys = [
        MODE,
        Key('rate', 'double', 'joint states per second', 'Hz', 500.0, 1.0, 10000.0),
        Key('substeps', 'integer', 'integration steps per joint state', '', 20, 1, 10000),
        Key('command_timeout', 'double', 'age of a command that still acts; then zero torque',
            's', 0.02, 1e-4, 10.0),
        Key('seed', 'integer', 'of the encoder noise', '', 0, 0, 2**31 - 1),
        Key('duration', 'double', 'simulated time after which the node ends; 0 is never', 's',
            0.0, 0.0, 1e7),
        Key('timing_file', 'string', 'JSON file for the timing of a realtime run', default=''),
        Key('wait_for_subscribers', 'integer', 'begin only when so many listen to the joint '
            'states', '', 0, 0, 100),
        Key('clock_rate', 'double', 'most /clock messages per simulated second, lockstep only',
            'Hz', 100.0, 0.1, 10000.0)]
    keys += [Key(f'initial.{joint}', 'double', 'link angle at the start', 'rad', 0.0)
             for joint in joints]
    return tuple(keys)


def trajectory_keys(joints):
    """Return the keys of the trajectory node."""
    keys = [
        MODE, PRIORITY,
        Key('trajectory.type', 'string', 'kind of reference', default='hold',
            choices=TRAJECTORIES, live=True),
        Key('trajectory.autostart', 'boolean', 'start at the first joint state', default=False),
        Key('trajectory.approach_time', 'double', 'duration of the way to its beginning', 's',
            2.0, 1e-3, 1e4, live=True),
        Key('trajectory.ramp_time', 'double', 'ramp of a sinusoid; settling of the others', 's',
            3.0, 1e-3, 1e4, live=True),
        Key('trajectory.move_time', 'double', 'duration of a move between rests', 's', 5.0, 1e-3,
            1e4, live=True),
        Key('trajectory.hold_time', 'double', 'duration of a rest', 's', 5.0, 0.0, 1e4,
            live=True),
        Key('trajectory.repeats', 'integer', 'cycles of polynomial and torque ramp', '', 1, 1,
            100000, live=True),
        Key('trajectory.travel', 'double', 'angle at constant velocity', 'rad', 0.5, 1e-6, 1e3,
            live=True),
        Key('trajectory.duration', 'double', 'of sliding', 's', 5.0, 1e-3, 1e5, live=True),
        Key('trajectory.modulation', 'double', 'relative variation of sliding', '', 0.5, 0.0,
            0.99, live=True),
        Key('trajectory.rate', 'double', 'slope of a torque ramp, mean slope between torque '
            'levels', 'N m/s', 0.02, 1e-9, 1e6, live=True),
        Key('trajectory.durations', 'double_array', 'of the velocity levels', 's', (1.0,), 1e-3,
            1e5, live=True)]
    for joint in joints:
        prefix = f'trajectory.{joint}.'
        keys += [
            Key(prefix + 'amplitude', 'double', 'of sinusoid and polynomial', 'rad', 1.0,
                live=True),
            Key(prefix + 'torque', 'double', 'amplitude of a torque ramp', 'N m', 0.0,
                live=True),
            Key(prefix + 'period', 'double', 'of sinusoid and sliding', 's', 6.0, 1e-3, 1e4,
                live=True),
            Key(prefix + 'phase', 'double', 'of the sinusoid', 'rad', 0.0, live=True),
            Key(prefix + 'velocity', 'double', 'of constant velocity and sliding', 'rad/s', 0.1,
                live=True),
            Key(prefix + 'velocities', 'double_array', 'velocity levels', 'rad/s', (0.0,),
                live=True),
            Key(prefix + 'offset', 'double', 'where constant velocity, velocity levels and '
                'sliding begin', 'rad', 0.0, live=True),
            Key(prefix + 'levels', 'double_array', 'torque levels, from zero and back to zero',
                'N m', (0.0,), live=True),
            Key(prefix + 'bias', 'double', 'added to torque ramp and torque levels, against '
                'gravity', 'N m', 0.0, live=True),
            Key(prefix + 'travel', 'double', 'this far moved ends torque ramp and torque levels, '
                '0 for never', 'rad', 0.0, 0.0, live=True),
            Key(prefix + 'points', 'double_array', 'via points, the first included', 'rad',
                (0.0, 1.0, 0.0), live=True)]
    return tuple(keys)


def identification_keys(joints):
    """Return the keys of the identification experiment."""
    prefix = 'identification.'
    keys = [
        Key(prefix + 'experiments', 'string_array', 'which of '
            f"{', '.join(EXPERIMENTS)}, in this order", default=EXPERIMENTS),
        Key(prefix + 'joints', 'string_array', 'joints to identify, in this order; empty is all',
            default=()),
        Key(prefix + 'compensation', 'string', 'friction compensation of the controller '
            'meanwhile', default='gms', choices=COMPENSATIONS),
        Key(prefix + 'margin', 'double', 'between planned angles and the range of a joint',
            'rad', 0.1, 0.0, 10.0),
        Key(prefix + 'rest_time', 'double', 'rest after each step', 's', 0.3, 0.0, 60.0),
        Key(prefix + 'relax_time', 'double', 'for the springs to unload before a torque step',
            's', 0.6, 0.3, 60.0),
        Key(prefix + 'settle_time', 'double', 'shortest change of velocity', 's', 0.3, 0.01,
            60.0),
        Key(prefix + 'speeds', 'integer', 'constant velocities per direction', '', 10, 2, 1000),
        Key(prefix + 'repeats', 'integer', 'of each constant velocity', '', 3, 1, 1000),
        Key(prefix + 'dwell_time', 'double', 'at each constant velocity, less where the range '
            'ends', 's', 1.0, 0.05, 1e4),
        Key(prefix + 'longest_dwell', 'double', 'at the slowest', 's', 10.0, 0.05, 1e4),
        Key(prefix + 'counts', 'double', 'least travel at constant velocity, in encoder counts',
            '', 20.0, 0.0, 1e6),
        Key(prefix + 'lead_in', 'double', 'sliding before a slow velocity, so that every block '
            'slips', 'rad', 0.35, 0.0, 100.0),
        Key(prefix + 'lead_in_speed', 'double', 'how fast that is', 'rad/s', 0.3, 1e-4, 100.0),
        Key(prefix + 'torque_rate', 'double', 'mean slope of torques, in F_s per second', '1/s',
            0.4, 1e-4, 100.0),
        Key(prefix + 'break_away_level', 'double', 'largest torque, in F_s', '', 1.3, 1.0, 3.0),
        Key(prefix + 'break_away_repeats', 'integer', 'per direction', '', 3, 1, 1000),
        Key(prefix + 'break_away_travel', 'double', 'this far moved is broken away', 'rad', 0.03,
            1e-5, 10.0),
        Key(prefix + 'presliding_levels', 'double_array', 'amplitudes, in F_s', '',
            (0.3, 0.5, 0.65, 0.8), 0.01, 0.99),
        Key(prefix + 'presliding_travel', 'double', 'this far moved is no presliding any more: '
            'the step ends', 'rad', 0.05, 1e-5, 10.0),
        Key(prefix + 'presliding_places', 'integer', 'at which each amplitude is applied, a '
            'shift apart', '', 3, 1, 1000),
        Key(prefix + 'presliding_cycles', 'integer', 'at each place', '', 1, 1, 1000),
        Key(prefix + 'minor_loop', 'double', 'amplitude of the loops nested in a cycle, 0 for '
            'none', '', 0.5, 0.0, 0.95),
        Key(prefix + 'shift', 'double', 'move between places, so that the angle within an '
            'encoder count differs', 'rad', 0.0501, 0.0, 1.0),
        Key(prefix + 'sliding_speeds', 'double_array', 'mean velocities, in v_s', '',
            (1.0, 2.0, 5.0), 0.01, 1000.0),
        Key(prefix + 'sliding_duration', 'double', 'less where the range ends', 's', 10.0, 0.1,
            1e4),
        Key(prefix + 'sliding_period', 'double', 'of the variation', 's', 0.8, 0.01, 100.0),
        Key(prefix + 'modulation', 'double', 'relative variation', '', 0.7, 0.0, 0.99)]
    for joint in joints:
        keys += _identified_joint_keys(f'{prefix}{joint}.')
    return tuple(keys)


def _identified_joint_keys(prefix):
    return (
        Key(prefix + 'lower', 'double', 'least angle allowed', 'rad', -1.0),
        Key(prefix + 'upper', 'double', 'largest angle allowed', 'rad', 1.0),
        Key(prefix + 'velocity', 'double', 'largest speed allowed', 'rad/s', 1.0, SMALLEST),
        Key(prefix + 'acceleration', 'double', 'largest planned', 'rad/s^2', 2.0, SMALLEST),
        Key(prefix + 'torque', 'double', 'largest motor torque allowed; 0 takes the torque limit '
            'of the controller', 'N m', 0.0, 0.0),
        Key(prefix + 'slowest', 'double', 'constant velocity; 0 takes a third of v_s', 'rad/s',
            0.0, 0.0),
        Key(prefix + 'fastest', 'double', 'constant velocity; 0 takes 0.9 of the limit',
            'rad/s', 0.0, 0.0),
        Key(prefix + 'static', 'double', 'expected F_s; 0 takes that of the robot file', 'N m',
            0.0, 0.0),
        Key(prefix + 'stribeck_velocity', 'double', 'expected v_s; 0 takes that of the robot '
            'file', 'rad/s', 0.0, 0.0))


def identification_node_keys():
    """Return the keys of the identification node beyond robot, gains and experiment."""
    prefix = 'identification.'
    return (
        MODE,
        Key(prefix + 'bag', 'string', 'recording to be made; a journal of the finished steps '
            'stands beside it', default='identification'),
        Key(prefix + 'resume', 'boolean', 'go on with the first step the journal lacks, into a '
            'bag beside the first', default=False),
        Key(prefix + 'autostart', 'boolean', 'begin as soon as all nodes are there',
            default=True),
        Key(prefix + 'fit', 'boolean', 'fit the friction when the last step is finished, into a '
            'folder beside the bag', default=True),
        Key(prefix + 'exit_when_done', 'boolean', 'end when the last step is finished',
            default=True),
        Key(prefix + 'trajectory_node', 'string', 'name of the trajectory node',
            default='trajectory'),
        Key(prefix + 'controller_node', 'string', 'name of the controller node',
            default='cascade_controller'),
        Key(prefix + 'plant_node', 'string', 'name of the plant; in lockstep it pauses while '
            'results are computed', default='plant'),
        Key(prefix + 'patience', 'double', 'for the other nodes to come', 's', 60.0, 0.1, 1e5),
        Key(prefix + 'silence', 'double', 'of states or commands that ends the experiment', 's',
            3.0, 0.1, 1e4))


def all_keys(joints):
    """Return the keys of all nodes by name, for one file shared by all."""
    keys = (*robot_keys(joints), *controller_keys(joints), *controller_node_keys(),
            *plant_node_keys(joints), *trajectory_keys(joints), *identification_keys(joints),
            *identification_node_keys(), *safety_keys(joints), *bridge_keys(joints))
    return {key.name: key for key in keys}
