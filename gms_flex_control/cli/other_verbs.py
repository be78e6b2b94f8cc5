# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Verbs of `gms_flex` beside those for a robot and its recordings, an entry of the table each."""

from gms_flex_control.cli.options import (
    BAG,
    CONTROLLER,
    JSON,
    LINKS,
    MOTORS,
    OneOf,
    option,
    OUT_FILE,
    out_folder,
    ROBOT,
    Verb,
)

SHELLS = ('bash', 'zsh', 'fish')
DEMO_MOTIONS, DEMO_MODES = ('sinusoid', 'polynomial'), ('none', 'gms_paper', 'gms')

_EFFECTS = Verb(
    'effects', 'robots.effects', 'the effects a robot file can have, with their parameters',
    'List the effects of the catalogue: what each is, how to write it in a robot file, and its '
    'parameters with their units. With names, only those effects.',
    (option('names', nargs='*', metavar='EFFECT', help='default: all of them'), JSON),
    ('effects', 'effects backlash end_stop --json'))
_RECORD = Verb(
    'record', 'bag_files.record', 'record topics into a bag',
    'Record topics, each as soon as it has a publisher, until Ctrl-C, SIGTERM or --duration. At '
    'most 0.2 s are lost if the recorder is killed; "gms_flex repair" then completes the bag. '
    'Exit code 1 if nothing was received.', (
        OneOf((option('--topics', nargs='+', metavar='TOPIC', help='what to record'),
               option('--all', action='store_true', help='every topic that is not hidden'))),
        out_folder('the bag to be made'),
        option('--duration', type=float, metavar='S', least=1e-3, help='stop after S seconds'),
        JSON),
    ('record --all --out my_bag',
     'record --topics /joint_states /effort_controller/commands /reference --duration 60 --out '
     'my_bag'))
_REPAIR = Verb(
    'repair', 'bag_files.repair', 'recover a killed, cut off or damaged bag',
    'Write every sound message of a bag to a new one, name what is lost. The old bag is not '
    'touched. Exit code 1 if messages were lost.',
    (BAG, option('--out', metavar='DIR', help='the new bag (default: BAG_repaired)'), JSON),
    ('repair my_bag', 'repair my_bag/my_bag_0.mcap --out mended'))
_ANALYSE = Verb(
    'analyse', 'recordings.analyse', "the paper's Table 4 and a report from bags",
    'Compare bags of one robot with and without friction compensation: table4.json, report.html '
    'and PNGs in one folder.', (
        option('bags', nargs='+', metavar='BAG',
               help='bag folder; its trajectory and compensation are taken from its metadata, '
                    'else from a name like sinusoid_none'),
        out_folder('folder for the results'),
        option('--label', action='append', default=[], metavar='TRAJECTORY_COMPENSATION',
               help='label of a bag, once per bag and in their order'),
        LINKS, MOTORS, JSON),
    ('analyse sinusoid_none sinusoid_gms --out results',
     'analyse before after --label sinusoid_none --label sinusoid_gms --out results'))
_CHECK_GAINS = Verb(
    'check-gains', 'tune.check_gains', 'conditions on the gains: value, limit, verdict',
    'Check the gains against Eq. (39), all rows, against the exact condition per joint, and bound '
    'the residual set (43). Exit code 1 if a condition fails.', (ROBOT, CONTROLLER, JSON),
    ('check-gains',
     'check-gains --robot robot.yaml friction.yaml --controller controller.yaml --json'))
_URDF = Verb(
    'urdf', 'robots.urdf', 'the robot as URDF, for RViz, robot_state_publisher and simulators',
    'Describe links, motors and inertias of a robot file as URDF. Springs, which URDF cannot '
    'express, become comments; friction is written as far as URDF has it.', (
        ROBOT, OUT_FILE,
        option('--name', default='arm', help='of the robot (default: %(default)s)'),
        option('--links-only', action='store_true', help='leave out the motors: a rigid robot'),
        option('--limits', nargs='+', metavar='FILE',
               help='files with limits.<joint>, such as config/bridge.yaml'),
        option('--ros2-control', metavar='PLUGIN', default='',
               help='add a <ros2_control> block with this hardware interface, such as '
                    'mock_components/GenericSystem')),
    ('urdf --robot robot.yaml --out arm.urdf',
     'urdf --robot robot.yaml --links-only --out rigid.urdf'))
_DEMO = Verb(
    'demo', 'demo.demo', "the paper's experiment over ROS 2, with table and report",
    'Start plant, controller and trajectory as three processes for every trajectory and '
    "compensation of the paper's section 6, record them into bags, and write Table 4, a report "
    'and pictures. The controller believes a robot with friction x 0.85, stiffness x 1.05 and '
    'masses x 0.93; the same with the exact model is simulated in this process for comparison.', (
        out_folder('folder for everything; made anew', 'demo_output'),
        option('--motions', nargs='+', default=DEMO_MOTIONS, choices=DEMO_MOTIONS,
               help='trajectories (default: all)'),
        option('--modes', nargs='+', default=DEMO_MODES, choices=DEMO_MODES,
               help='compensations (default: all)'),
        option('--duration', type=float, metavar='S',
               help='simulated length of each run (default: sinusoid 20, polynomial to its end)'),
        JSON),
    ('demo', 'demo --motions sinusoid --modes none gms --duration 6 --out short'))
_COMPLETION = Verb(
    'completion', 'main.completion',
    'complete verbs, options and files by TAB in bash, zsh and fish',
    'Print what a shell reads to complete commands of gms_flex; put the line of the example into '
    '~/.bashrc or ~/.zshrc. Needs argcomplete, which comes with ros2 and colcon.',
    (option('shell', choices=SHELLS),),
    ('eval "$(gms_flex completion bash)"',
     'completion fish > ~/.config/fish/completions/gms_flex.fish'))

OTHERS = (
    _EFFECTS, _RECORD, _REPAIR, _ANALYSE, _CHECK_GAINS, _URDF, _DEMO, _COMPLETION)
