# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Examples for the help of every verb that does not bring its own."""

from argparse import RawDescriptionHelpFormatter
import textwrap

_WIDTH = 79
EXAMPLES = {
    'demo': ['gms_flex demo',
             'gms_flex demo --motions sinusoid --modes none gms --duration 6 --out short'],
    'demo-identify': ['gms_flex demo-identify --out demo_identify_output'],
    'demo-discrepancy': ['gms_flex demo-discrepancy --seed 3',
                         'gms_flex demo-discrepancy --effect position_friction --duration 30 '
                         '--out found'],
    'simulate': ['gms_flex simulate --out my_bag',
                 'gms_flex simulate --compensation none gms --trajectory sinusoid polynomial '
                 '--out bags',
                 'gms_flex simulate --robot robot.yaml results/friction.yaml --set '
                 'gains.joint1.kd_link=1.0 --out my_bag'],
    'record': ['gms_flex record --all --out my_bag',
               'gms_flex record --topics /joint_states /effort_controller/commands /reference '
               '--duration 60 --out my_bag'],
    'info': ['gms_flex info my_bag', 'gms_flex info my_bag --json'],
    'repair': ['gms_flex repair my_bag', 'gms_flex repair my_bag/my_bag_0.mcap --out mended'],
    'analyse': ['gms_flex analyse sinusoid_none sinusoid_gms --out results',
                'gms_flex analyse before after --label sinusoid_none --label sinusoid_gms '
                '--out results'],
    'import-csv': ['gms_flex import-csv rec_A.csv --map import_kr300.yaml --out kr300',
                   'gms_flex import-csv log.csv --map my_map.yaml --resample 500 --out log_bag'],
    'check-gains': ['gms_flex check-gains',
                    'gms_flex check-gains --robot robot.yaml friction.yaml --controller '
                    'controller.yaml --json'],
    'tune': ['gms_flex tune --out tuned',
             'gms_flex tune --robot robot.yaml results/friction.yaml --torque-limit 2 --delay 1 '
             '--verify 200 --intervals results/report.json --out tuned'],
    'compare': ['gms_flex compare', 'gms_flex compare robot.yaml --controller '
                'tuned/controller.yaml --out comparison',
                'gms_flex compare robot.yaml results/friction.yaml --draws 20',
                'gms_flex compare my_bag --robot robot.yaml --out along_bag'],
    'torsion': ['gms_flex torsion kr300 --joint axis1 --stiffness 4.58e6 --out torsion'],
    'identify': ['gms_flex identify my_bag --robot robot.yaml --out results',
                 'gms_flex identify first second --robot robot.yaml --holdout third --out results',
                 'gms_flex identify my_bag --out results',
                 'gms_flex identify bags/* --each --robot robot.yaml --workers 4 --out each',
                 'gms_flex identify bags/* --each --robot robot.yaml --scheduler tcp://host:8786 '
                 '--out /shared/each'],
    'discrepancy': ['gms_flex discrepancy my_bag --robot robot.yaml --out results',
                    'gms_flex discrepancy my_bag --robot robot.yaml friction.yaml --holdout '
                    'another_bag --out results',
                    'gms_flex discrepancy bags/* --each --robot robot.yaml --workers 4 '
                    '--out each'],
    'effects': ['gms_flex effects', 'gms_flex effects backlash end_stop --json'],
    'export': ['gms_flex export --to mujoco --robot robot.yaml friction.yaml --out arm.xml',
               'gms_flex export --to mujoco --without attraction stribeck_direction '
               '--out arm.xml',
               'gms_flex export --to csv --robot results/robot.yaml --out parameters.csv'],
    'urdf': ['gms_flex urdf --robot robot.yaml --out arm.urdf',
             'gms_flex urdf --robot robot.yaml --links-only --out rigid.urdf'],
    'view': ['gms_flex view my_bag --robot config/robot.yaml',
             'gms_flex view sinusoid_gms sinusoid_none', 'gms_flex view live'],
    'completion': ['eval "$(gms_flex completion bash)"',
                   'gms_flex completion fish > ~/.config/fish/completions/gms_flex.fish']}


def add_examples(parsers, examples=EXAMPLES):
    """
    Put examples at the end of the help of verbs.

    Parameters
    ----------
    parsers : dict of str to ArgumentParser
        The verbs by name; one that is not in ``examples`` keeps what it has.
    examples : dict of str to list of str
        Commands by verb.

    """
    for name, parser in parsers.items():
        if name in examples:
            lines = [line for example in examples[name] for line in _broken(example)]
            parser.description = textwrap.fill(parser.description, _WIDTH)
            parser.epilog = '\n'.join(['examples:', *(f'  {line}' for line in lines)])
            parser.formatter_class = RawDescriptionHelpFormatter


def _broken(example):
    """Return a command in lines that a shell takes as they are."""
    lines = textwrap.wrap(example, _WIDTH - 4, subsequent_indent='    ', break_on_hyphens=False,
                          break_long_words=False)
    return [f'{line} \\' for line in lines[:-1]] + lines[-1:]
