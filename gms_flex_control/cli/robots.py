# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The verbs on robot files: `simulate`, `effects`, `export`, `urdf`."""

from itertools import product
from pathlib import Path
import re

from gms_flex_control.answer import command
from gms_flex_control.cli.terminal import end, refuse_overwriting, write_or_print
from gms_flex_control.data.recording import MOTOR_SUFFIX
from gms_flex_control.data.writer import refuse_existing
from gms_flex_control.effects import registry
from gms_flex_control.errors import ConfigError, nearest
from gms_flex_control.experiment.simulated import read_plan, simulate_to_bag
from gms_flex_control.file_io import controller_file, robot_file, share_path
from gms_flex_control.params.arm import in_units
from gms_flex_control.params.gains import COMPENSATIONS
from gms_flex_control.schema import mujoco, target
from gms_flex_control.schema.files import load_limits, load_robot, read_parameters
from gms_flex_control.schema.urdf import robot_urdf
import numpy as np
from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError


def simulate(args) -> int:
    """Simulate, write the bags and print the tracking errors; return 0."""
    overrides = dict(parse_override(text) for text in args.overrides)
    modes = args.compensation or [None]
    robot, results = args.robot or [robot_file()], []
    joints = load_robot(robot).joints
    controller = controller_of(args, joints)
    if any(not Path(motion).suffix for motion in args.trajectory):
        _require_paper('--trajectory', 'motions', joints, 'gms_flex tune or plan write')
    for mode in filter(None, modes):
        if mode not in COMPENSATIONS:
            raise ConfigError(f'--compensation {mode}: must be one of {", ".join(COMPENSATIONS)}'
                              f'{nearest(mode.lower(), COMPENSATIONS)}')
    plans = [(motion, read_plan(
        [*robot, *controller, trajectory_file(motion)], model=args.model,
        overrides=overrides | ({'compensation': mode} if mode else {}), duration=args.duration))
        for motion, mode in product(args.trajectory, modes)]
    several = len(plans) > 1
    bags = _bags_of(plans, args.out) if several else [Path(args.out)]
    for bag in bags:
        refuse_existing(bag)
    for bag, (_, plan) in zip(bags, plans, strict=True):
        outcome = simulate_to_bag(plan, bag)
        error = outcome.q_link - outcome.reference[:, 0]
        results.append({'bag': str(bag), 'trajectory': plan.motion,
                        'compensation': plan.gains.compensation, 'duration': plan.duration,
                        'mse': np.mean(error ** 2, axis=0).tolist()})
        if not args.json:
            shown = '  '.join(f'{value:.3g}' for value in results[-1]['mse'])
            square = in_units(plan.robot.arm, 'rad^2')
            print(f'{bag}: {plan.motion}, {plan.gains.compensation}, {plan.duration:g} s, '
                  f'MSE per link [{square}]  {shown}')
    again = 'view', *bags, *(['--robot', *args.robot] if args.robot else ())
    if several:
        again = 'analyse', *bags, *_names(plan.robot), '--out', Path(args.out) / 'results'
    return end(args, results, f'\nnext: {command(*again)}')


def _bags_of(plans, out):
    """Return a path below ``out`` for the bag of each (motion, Plan); refuse equal ones."""
    names = [f'{Path(motion).stem}_{plan.gains.compensation}' for motion, plan in plans]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f'--trajectory and --compensation make {names.count(name)} bags '
                              f'named {name}; give each once, and motions different file names')
    return [Path(out) / name for name in names]


def _names(robot):
    """Return options that name links and motors, if names alone do not show which is which."""
    if all(motor in ('', joint + MOTOR_SUFFIX)
           for joint, motor in zip(robot.joints, robot.motors, strict=True)):
        return ()
    return '--joints', *robot.joints, '--motors', *robot.motors


def controller_of(args, joints) -> list:
    """Return the files of --controller, by default the paper's if they are for these joints."""
    if not args.controller:
        _require_paper('--controller', 'gains', joints, 'gms_flex tune proposes')
    return args.controller or [controller_file()]


def _require_paper(option, what, joints, way_out):
    """Refuse what config/ has for the arm of the paper where joints are other ones."""
    known = load_robot(robot_file()).joints
    if tuple(joints) != known:
        raise ConfigError(
            f'{option} needs a file: {what} of config/ are for {", ".join(known)}, this robot has '
            f'{", ".join(joints)}; {way_out} some')


def parse_override(text: str) -> tuple:
    """Return name and value of ``name=value``, the value read as YAML; raise ConfigError."""
    name, equals, value = text.partition('=')
    if not equals or not name:
        raise ConfigError(f'--set {text!r} must have the form NAME=VALUE')
    try:
        return name, YAML(typ='safe').load(value)
    except YAMLError as error:
        raise ConfigError(f'--set {name}: {value!r} is not a YAML value') from error


def trajectory_file(name) -> Path:
    """Return the path of a trajectory file given as a path or as a name from config/."""
    if Path(name).suffix:
        if not any(key.startswith('trajectory.') for key in read_parameters(name)):
            raise ConfigError(f'--trajectory {name}: states no trajectory.* parameter, so the arm '
                              'would only hold; is it another file?')
        return Path(name)
    path = share_path() / 'config' / f'{name}.yaml'
    if not path.is_file():
        raise ConfigError(f'--trajectory {name}: no such file in {path.parent}; give a path or '
                          'one of sinusoid, polynomial')
    return path


def effects(args) -> int:
    """Print the effects of the catalogue; return 0."""
    found = [_effect_values(registry.find(name)) for name in args.names or registry.names()]
    return end(args, found, '\n'.join(line for entry in found for line in (
        f'{entry["name"]}: {entry["what"]}',
        *(f'    {one["key"]}  [{one["unit"]}]  {one["meaning"]}' for one in entry['parameters']))))


def _effect_values(kind):
    """Return what is printed of an effect class, dict; JSON has no infinity."""
    place = 'arm' if kind.whole_arm else '<joint>'
    return {'name': kind.name, 'what': registry.in_words(kind.name), 'parameters': [
        {'key': f'effects.{place}.{kind.name}.{one.name}', 'unit': one.unit,
         'meaning': one.description} | {
            name: bound if np.isfinite(bound) else None
            for name, bound in (('lower', one.lower), ('upper', one.upper))}
        for one in kind.parameters]}


def export(args) -> int:
    """Write or print a robot for another program; return 0."""
    robot = _to_be_written(args)
    write_or_print(_exported(robot, args), args.out, f'{robot.n_joints} joints')
    return 0


def _to_be_written(args):
    """Return the robot of the arguments, none of its files being --out."""
    robot = load_robot(args.robot or robot_file())
    refuse_overwriting(args, further=[robot.arm.frames.source] if robot.arm.frames else ())
    return robot


def _exported(robot, args):
    if args.timestep is not None and (args.to != 'mujoco' or not 0.0 < args.timestep < 1.0):
        raise ConfigError(f'--timestep {args.timestep:g} --to {args.to}: give an integration step '
                          'above 0 s and below 1 s, to mujoco only')
    if args.to == 'mujoco' and robot.arm.frames:
        raise ConfigError(f'--to mujoco: MuJoCo reads {robot.arm.frames.source} itself; of '
                          'arm.kind urdf friction alone is exported, --to urdf, ros2_control or '
                          'csv')
    if args.to == 'csv':
        if args.without:
            raise ConfigError('--without: csv holds every parameter; leave the option out')
        return target.table(robot)
    step = {} if args.timestep is None else {'timestep': args.timestep}
    chosen = {'mujoco': mujoco.target(**step), 'urdf': target.URDF,
              'ros2_control': target.ROS2_CONTROL}
    return target.export(robot, chosen[args.to], args.without)


def urdf(args) -> int:
    """Write or print a robot as URDF; return 0."""
    robot = _to_be_written(args)
    for option, given in (('name', args.name), ('ros2-control', args.ros2_control)):
        if given is not None and not re.fullmatch(r'\S+', given):
            raise ConfigError(f'--{option} {given!r}: give one word, such as '
                              f'{"arm" if option == "name" else "my_hardware/MySystem"}')
    if robot.arm.frames and (args.limits or args.ros2_control):
        raise ConfigError(f'the URDF of this robot is {robot.arm.frames.source}: limits and '
                          '<ros2_control> belong into that file')
    limits = load_limits(args.limits, robot.joints) if args.limits else None
    if args.limits and limits is None:
        raise ConfigError(f'--limits {" ".join(args.limits)}: no limits.<joint> is in it')
    text = robot_urdf(robot, name=args.name, motors=not args.links_only, limits=limits,
                      plugin=args.ros2_control or '')
    write_or_print(text, args.out, f'{robot.n_joints} joints')
    return 0
