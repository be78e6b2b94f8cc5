# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""The verbs of `gms_flex`: an entry of the table each, whose module is imported when it runs."""

from gms_flex_control.cli.options import (
    BAG,
    CONTROLLER,
    FORCE,
    JSON,
    LINKS,
    MOTORS,
    number,
    OneOf,
    option,
    OUT_FILE,
    out_folder,
    ROBOT,
    SEED,
    Verb,
    WIDEN,
    WORKERS,
)
from gms_flex_control.params.gains import COMPENSATIONS

DEMO_MOTIONS, DEMO_MODES = ('sinusoid', 'polynomial'), ('none', 'gms_paper', 'gms')

_EFFECTS = Verb(
    'effects', 'robots.effects', 'the effects a robot file can have, with their parameters',
    'List the effects of the catalogue: what each is, how to write it in a robot file, and its '
    'parameters with their units. With names, only those effects. On linear axes m stands for '
    'rad, N for N m, and 2 pi m for a revolution; a phase remains an angle.',
    (option('names', nargs='*', metavar='EFFECT', help='default: all of them'), JSON),
    ('effects', 'effects backlash end_stop --json'))
_RECORD = Verb(
    'record', 'bags.record', 'record topics into a bag',
    'Record topics, each as soon as it has a publisher, until Ctrl-C, SIGTERM or --duration. At '
    'most 0.2 s are lost if the recorder is killed. Exit code 1 if nothing was received.', (
        OneOf((option('--topics', nargs='+', metavar='TOPIC', help='what to record'),
               option('--all', action='store_true', help='every topic that is not hidden'))),
        out_folder('the bag to be made'),
        option('--duration', type=float, metavar='S', least=1e-3, help='stop after S seconds'),
        JSON),
    ('record --all --out my_bag',
     'record --topics /joint_states /effort_controller/commands /reference --duration 60 --out '
     'my_bag'))
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
        option('--ros2-control', metavar='PLUGIN',
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
EXPORTS = ('mujoco', 'urdf', 'ros2_control', 'csv')

_IMPORT_CSV = Verb(
    'import-csv', 'recordings.import_csv', 'turn a text log into a bag',
    'Read a CSV or similar log as a map file says (columns, units, signs, gear ratios) and write '
    'it as a bag; say what looks wrong in it.', (
        option('file', help='the log, UTF-8 text'),
        option('--map', required=True, dest='map_file', metavar='FILE',
               help='YAML map; a bare name is looked for in the package too, for instance '
                    'import_kr300.yaml'),
        out_folder('folder of the bag, must not exist'),
        option('--resample', type=float, metavar='HZ',
               help='put all on a fixed rate; by default the stamps stay as they are'), JSON),
    ('import-csv rec_A.csv --map import_kr300.yaml --out kr300',
     'import-csv log.csv --map my_map.yaml --resample 500 --out log_bag'))
_INFO = Verb(
    'info', 'bags.info', 'topics, rates, gaps and joints of a bag',
    'Read a whole bag and list what is in it. Exit code 1 if messages are lost or damaged.',
    (BAG, JSON), ('info my_bag', 'info my_bag --json'))
_VIEW = Verb(
    'view', 'bags.view', 'the arm moving in a browser, from a bag or live',
    'Serve a page that shows the arm, its spring deflection, tracking error, torque and friction '
    'blocks: a bag to play and scrub, or the running loop with sliders for the gains of the '
    'controller. Everything comes from this one process and stays on this machine. Ctrl-C ends '
    'it.', (
        option('what', metavar='BAG|live', nargs='+',
               help='bags, the others drawn pale over the first, such as with and without '
                    'compensation; or the word live (needs ROS)'),
        option('--robot', nargs='+', metavar='FILE',
               help='robot file of the bag, and others that complete it, such as friction.yaml; '
                    'default: that of the package where the joints have the same names'),
        LINKS, MOTORS,
        option('--namespace', default='', metavar='NS',
               help='namespace of the running nodes, such as /left'),
        option('--controller', metavar='NODE',
               help='full name of the controller node; default: /cascade_controller in the '
                    'namespace'),
        option('--port', type=int, default=8642, least=0, most=65535,
               help='0 takes a free one (default: %(default)s)'),
        option('--open', action='store_true', help='open the page in a browser')),
    ('view my_bag --robot config/robot.yaml', 'view sinusoid_gms sinusoid_none', 'view live'))
_IDENTIFY = Verb(
    'identify', 'recordings.identify_bags',
    'friction parameters from bags, with intervals and a report',
    'Fit the friction of a robot to bags of identification_node, of `ros2 bag record` or of '
    'import-csv. Writes friction.yaml, which plant and controller take as it is, report.json, '
    'report.html and pictures. Inertia, stiffness and gravity of the robot file are as sure as '
    'its uncertainty says; --estimate all finds and writes them as well.', (
        option('bags', nargs='+', metavar='BAG', help='bags of one robot, fitted together'),
        option('--robot', metavar='FILE', nargs='+',
               help='robot parameters, later files winning; by default each joint of the bag is '
                    'a rigid axis of its own and all is estimated'),
        out_folder('folder for the results'),
        option('--holdout', nargs='+', default=[], metavar='BAG',
               help='bags that are only predicted; default: every fourth block of 2 s'),
        option('--estimate', choices=('friction', 'all'), default='friction',
               help='all: inertia, gravity, stiffness, motor inertia as well'),
        option('--blocks', type=int, nargs='+', metavar='N',
               help='numbers of Maxwell blocks to choose from'),
        option('--joints', nargs='+', metavar='NAME',
               help='joints to take from the bags; default: all of the robot'),
        WIDEN, FORCE, JSON),
    ('identify my_bag --robot robot.yaml --out results',
     'identify first second --robot robot.yaml --holdout third --out results',
     'identify my_bag --out results'))
_DISCREPANCY = Verb(
    'discrepancy', 'recordings.discrepancy_verb',
    'find what a model lacks, name it, add it, show the gap shrink',
    'Compare a model with bags of its robot, recorded or simulated; name the physical effects it '
    'lacks, write them into DIR/robot.yaml, and show on held-out data how much better it '
    'predicts: report.json, report.html, pictures. Exit codes: 0 nothing is missing, 1 effects '
    'were found or something is unexplained, 2 the data or the input are bad.', (
        option('bags', nargs='+', metavar='BAG', help='bags of one robot'),
        option('--robot', metavar='FILE', nargs='+', required=True,
               help='the model one believes in, later files winning'),
        out_folder('folder for the results'),
        option('--holdout', nargs='+', default=[], metavar='BAG',
               help='bags on which the gap is measured; default: blocks of 2 s, each predicted '
                    'from the others'),
        option('--max-effects', type=int, metavar='N', least=1,
               help='how many effects may be added (default: 20)'),
        option('--without', nargs='+', default=[], metavar='EFFECT',
               help='effects of the catalogue that are not considered'),
        option('--learn', action='store_true',
               help='where something remains unexplained, learn a term for it that physics '
                    'allows, without a name, and add it to the model if it predicts held-out '
                    'data better'),
        WIDEN,
        option('--models', nargs='+', default=[], metavar='FILE',
               help='further models of the robot to compare on the same bags'),
        option('--controller', nargs='+', default=[], metavar='FILE',
               help='the controller that drove the robot while it believed --robot: its closed '
                    'loop is simulated along the recorded /reference, too'),
        FORCE, JSON),
    ('discrepancy my_bag --robot robot.yaml --out results',
     'discrepancy my_bag --robot robot.yaml friction.yaml --holdout another_bag --out results'))
_SIMULATE = Verb(
    'simulate', 'robots.simulate', 'the closed loop without ROS, as a bag',
    'Simulate plant, controller and reference in this process from the parameter files of the '
    'nodes and write the same bag they would. Several trajectories or compensations make one bag '
    'each, in the folder --out, named <trajectory>_<compensation>.', (
        ROBOT,
        option('--model', nargs='+', metavar='FILE',
               help='robot files the controller believes in; default: --robot'),
        CONTROLLER,
        option('--trajectory', nargs='+', default=['sinusoid'], metavar='FILE',
               help='file with trajectory parameters, or the name of one of config/'),
        option('--compensation', nargs='+', metavar='MODE', completer=lambda **_: COMPENSATIONS,
               help=f'any of {", ".join(COMPENSATIONS)}; default: that of the controller file'),
        option('--set', nargs='+', default=[], metavar='NAME=VALUE', dest='overrides',
               help='single parameters, such as gains.joint1.kd_link=1.0'),
        option('--duration', type=float, metavar='S',
               help='default: until the trajectory ends, 20 s if it has no end'),
        out_folder('the bag, or their folder'), JSON),
    ('simulate --out my_bag',
     'simulate --compensation none gms --trajectory sinusoid polynomial --out bags',
     'simulate --robot robot.yaml results/friction.yaml --set gains.joint1.kd_link=1.0 --out '
     'my_bag'))
_NEXT = Verb(
    'next', 'designs.next_recording', 'the motion to record next, to separate explanations',
    'Read a result of discrepancy that leaves several explanations and choose the motion that '
    'separates them fastest: each is simulated as the robot, and all are fitted to that '
    'simulation beside the recordings so far. Every explanation, also two standard deviations '
    'from its fit, keeps the limits. With --run the plan is driven and recorded, with --simulate '
    'simulated, and so on until one explanation is left, the budget is spent or no motion '
    'separates them. Exit code 1 if one is not left, or not likely to be, or, of a result of '
    'identify, if nothing more is determined.', (
        option('result', metavar='RESULT', help='folder that discrepancy wrote'),
        option('--robot', nargs='+', required=True, metavar='FILE',
               help='robot files that discrepancy was given, later ones winning'),
        CONTROLLER,
        option('--limits', nargs='+', required=True, metavar='FILE',
               help='limits.<joint>.* as of the bridge: lower, upper, velocity, torque, '
                    'torque_rate'),
        option('--effects', nargs='+', metavar='EFFECT:JOINT[+EFFECT:JOINT]',
               help='explanations to separate; default: those that RESULT leaves'),
        number('--rate', 'HZ', 500.0, 'of the controller', least=10.0, most=10_000.0),
        option('--run', action='store_true', dest='with_ros',
               help='drive it with the nodes that run, record, and go on'),
        option('--simulate', nargs='+', metavar='FILE',
               help='likewise with a simulated robot, of these files'),
        number('--budget', 'S', 60.0, 'robot time of --run and --simulate', least=5.0, most=36e3),
        option('--odds', type=float, default=99.0, least=1.5, most=1e9,
               help='wanted between every pair (default: %(default)g)'),
        number('--longest', 'S', 60.0, 'motion', least=8.0, most=3600.0),
        option('--weight', type=float, default=0.0, least=0.0, most=1e4, metavar='KG',
               help='that you can hang at the tip, where no motion alone separates them'),
        out_folder('folder for the plan'), JSON),
    ('next gap --robot robot.yaml --limits bridge.yaml --out plan',
     'next gap --robot robot.yaml --limits bridge.yaml --run --budget 60 --out rounds',
     'next gap --robot robot.yaml --limits bridge.yaml --effects backlash:joint2 '
     'stiffness_error:joint2 --out plan'))
_PLAN = Verb(
    'plan', 'designs.plan', 'the motion that identifies an arm of a URDF best',
    'Search the Fourier series with the smallest condition number of the base parameters within '
    'position, velocity, acceleration and torque limits of the URDF and the options, links as '
    'capsules that do not meet. Writes trajectory.yaml for trajectory_node and simulate; takes '
    'about a minute.', (
        option('--robot', nargs='+', required=True, metavar='FILE',
               help='robot files of arm.kind urdf, later ones winning'),
        option('--limits', nargs='+', metavar='FILE',
               help='limits.<joint>.* as of the bridge, lower, upper, velocity, torque: narrower '
                    'than those of the URDF'),
        option('--acceleration', type=float, metavar='RAD/S2', least=1e-3,
               help='largest of every joint (default: none)'),
        option('--period', type=float, default=10.0, metavar='S', least=0.5, most=600.0,
               help='of the first harmonic (default: %(default)g)'),
        option('--harmonics', type=int, default=5, metavar='N', least=2, most=20,
               help='default: %(default)d'),
        option('--repeats', type=int, default=2, metavar='N', least=1, most=1000,
               help='periods (default: %(default)d)'),
        option('--radius', type=float, metavar='M', least=0.0, most=10.0,
               help='of the links as capsules; 0 checks no collisions (default: 5 %% of the '
                    'length of the arm)'),
        SEED, out_folder('folder for the plan'), JSON),
    ('plan --robot examples/industrial_arm/robot.yaml --out plan',
     'plan --robot robot.yaml --limits bridge.yaml --acceleration 10 --out plan'))
_TUNE = Verb(
    'tune', 'tune.tune', 'gains for a robot: proposed, judged, tried, verified',
    'Propose the stiffest gains of the cascade controller that keep margins, encoder noise and '
    'the conditions (39), show margins and expected tracking error, and write controller.yaml. '
    'Exit code 1 if no gains meet the requirements, or a robot drawn by --verify is lost.', (
        ROBOT,
        option('--controller', nargs='+', metavar='FILE',
               help='compensation, observer and torque limits; default: gms, k_e 1'),
        option('--torque-limit', nargs='+', type=float, metavar='NM',
               help='of each joint, or one for all; default: of --controller'),
        number('--rate', 'HZ', 500.0, 'of the controller', least=1.0),
        number('--delay', 'MS', 0.0, 'from measurement to torque', least=0.0, most=50.0),
        option('--bandwidth', nargs='+', type=float, metavar='RAD/S',
               help='of each link, or one for all; default: as much as margins allow'),
        number('--damping', 'D', 1.0, 'of the pair of link poles, at least 1', least=1.0),
        number('--gain-margin', 'TIMES', 2.0, 'factor on the torque, up and down', least=1.0),
        option('--phase-margin', type=float, default=30.0, metavar='DEG', least=0.0,
               help='default: %(default)g'),
        option('--delay-margin', type=float, metavar='MS', least=0.0,
               help='further delay that the loop must tolerate (default: one sample)'),
        number('--noise', 'SHARE', 0.1,
               'of the torque limit that encoder noise may take as rms torque', least=1e-6),
        number('--amplitude', 'RAD', 1.0, 'of the motions simulated', least=1e-6),
        option('--verify', type=int, default=0, metavar='N', least=0,
               help='try the gains on N robots drawn with friction and M off by up to 30 %%, K by '
                    '20 %%'),
        SEED, WORKERS,
        out_folder('controller.yaml, trajectory.yaml, tuning.json, tuning.png'), JSON),
    ('tune --out tuned',
     'tune --robot robot.yaml results/friction.yaml --torque-limit 2 --delay 1 --verify 200 '
     '--out tuned'))
_COMPARE = Verb(
    'compare', 'tune.compare', 'friction compensations side by side',
    'Compare eight ways to compensate friction: none, static Stribeck, LuGre, four kinds of GMS '
    '(of the paper, improved, of the desired motion, adaptive) and a disturbance observer. Each '
    'drives the plant in simulation, also with friction, K and M that differ from the belief, '
    'with coarse and fine encoders, and at other rates.', (
        option('robot', nargs='*', metavar='PLANT',
               help='robot files, later ones winning; default: the arm of the paper'),
        CONTROLLER,
        option('--draws', type=int, default=50, metavar='N', least=0,
               help='robots with all parameters off at once (default: %(default)d)'),
        number('--rate', 'HZ', 500.0, 'of the controller', least=1e-3, most=1e4),
        number('--amplitude', 'RAD', 1.0, 'of the motions', least=1e-6, most=100.0),
        SEED, WORKERS,
        out_folder('report.html, comparison.json, trajectory.yaml', 'comparison'), JSON),
    ('compare', 'compare robot.yaml --controller tuned/controller.yaml --out comparison',
     'compare robot.yaml results/friction.yaml --draws 20'))
_EXPORT = Verb(
    'export', 'robots.export',
    'the identified robot for MuJoCo, URDF, ros2_control, or as a table',
    'Write a robot with its friction and effects for another program. What that program cannot '
    'express is refused by name; --without exports the robot without it. mujoco: MJCF with '
    'springs, friction blocks, limits and delay of the actuators. urdf: a rigid robot with '
    '<dynamics>. ros2_control: viscous and Coulomb friction of each joint as ROS parameters. csv: '
    'every parameter with its unit.', (
        option('--to', required=True, choices=EXPORTS, help=', '.join(EXPORTS), metavar='TARGET'),
        ROBOT,
        option('--without', nargs='+', default=[], metavar='NAME',
               help='parts of the model or effects to leave out'),
        option('--timestep', type=float, metavar='S', help='integration step of MuJoCo [s]'),
        OUT_FILE),
    ('export --to mujoco --robot robot.yaml friction.yaml --out arm.xml',
     'export --to mujoco --without attraction stribeck_direction --out arm.xml',
     'export --to csv --robot results/robot.yaml --out parameters.csv'))

GROUPS = {
    'for a robot and its recordings': (
        _IMPORT_CSV, _INFO, _VIEW, _IDENTIFY, _DISCREPANCY, _NEXT, _PLAN, _SIMULATE, _TUNE,
        _COMPARE, _EXPORT),
    'beside these': (
        _EFFECTS, _RECORD, _ANALYSE, _CHECK_GAINS, _URDF, _DEMO)}
