# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""Imports point one way, ROS stays under nodes/, the bench outside, effects in their files."""

import ast
from graphlib import TopologicalSorter
from importlib import util
from pathlib import Path
import re

import gms_flex_control
from gms_flex_control.compiled import KERNELS
from gms_flex_control.effects import registry
import pytest

pytestmark = pytest.mark.fast

PACKAGE = 'gms_flex_control'
ROOT = Path(gms_flex_control.__file__).parent
# each may import those before it, and itself; one that does not exist yet does no harm
LAYERS = ['errors', 'file_io', 'batches', 'answer', 'compiled', 'records',
          'params', 'friction', 'effects', 'dynamics', 'trajectory',
          'control', 'hardware', 'schema', 'simulation', 'data',
          'experiment', 'identification', 'discrepancy', 'design',
          'tuning', 'reports', 'results', 'view', 'nodes', 'cli']
ROS = re.compile(r'rclpy|rcl_interfaces|ament_index_python|launch(_ros)?|\w+_(msgs|srvs)')
BAGS = re.compile(r'rosbags|mcap')
NOT_INSTALLED = {'bench', 'scripts', 'test'}
MODULES = {path.relative_to(ROOT).as_posix(): path for path in sorted(ROOT.rglob('*.py'))
           if path != ROOT / '__init__.py'}


def imports(tree, module, inside_function=False):
    """Yield (absolute dotted name, inside a function?, line) of every import."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, inside_function, node.lineno
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ''
            if node.level:
                parents = [PACKAGE, *Path(module).parts]
                base = '.'.join([*parents[:-node.level], *filter(None, [base])])
            if base == PACKAGE:
                for alias in node.names:
                    yield f'{base}.{alias.name}', inside_function, node.lineno
            else:
                yield base, inside_function, node.lineno
        else:
            inside = inside_function or isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))
            yield from imports(node, module, inside)


def complaints(source, module):
    """Return what the layers forbid in one module given by its path within the package."""
    layer = Path(module).parts[0].removesuffix('.py')
    if layer not in LAYERS:
        return [f'{module}: {layer!r} has no place in LAYERS yet; put it where it belongs']
    found = []
    for name, lazy, line in imports(ast.parse(source), module):
        top, _, rest = name.partition('.')
        target = rest.partition('.')[0]
        if ROS.fullmatch(top) and layer != 'nodes':
            found.append(f'{module}:{line} imports {name}: ROS belongs under nodes/')
        elif BAGS.fullmatch(top) and layer != 'data':
            found.append(f'{module}:{line} imports {name}: bag libraries belong under data/')
        elif top in NOT_INSTALLED:
            found.append(f'{module}:{line} imports {name}, which is not installed')
        elif top != PACKAGE or not target.isidentifier() or target.startswith('__'):
            continue
        elif target not in LAYERS or LAYERS.index(target) > LAYERS.index(layer):
            found.append(f'{module}:{line} imports {name}, which is above {layer}')
        elif layer == 'cli' and target == 'nodes' and not lazy:
            found.append(f'{module}:{line} imports {name} outside a function: '
                         'the offline verbs must start without ROS')
    return found


@pytest.mark.parametrize('module', MODULES)
def test_imports_point_downwards(module):
    assert complaints(MODULES[module].read_text(encoding='utf-8'), module) == []


def test_tests_are_named_after_the_part_of_the_package_they_test():
    """Or after what they look at in all of it."""
    of_all = {'colcon_workspace', 'flake8', 'import_direction', 'package', 'tutorials'}
    names = {path.stem.removeprefix('test_') for path in Path(__file__).parent.glob('test_*.py')}
    assert {name for name in names - of_all if name.split('_')[0] not in LAYERS} == set()


def modules_imported(source, module):
    """Return the modules of the package that one imports, also within functions, set of str."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            names |= {f'{node.module}.{alias.name}' for alias in node.names} | {node.module}
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
    paths = {f"{name.removeprefix(f'{PACKAGE}.').replace('.', '/')}.py" for name in names}
    return paths.intersection(MODULES) - {module}


def test_no_module_imports_itself_by_way_of_others():
    TopologicalSorter({module: modules_imported(path.read_text('utf-8'), module)
                       for module, path in MODULES.items()}).prepare()


def test_a_kernel_that_others_call_is_part_of_the_name_of_their_cache():
    """Else they stay compiled with what it was before a change."""
    kernels = {name: text for name, path in MODULES.items()
               if '\n@compiled\n' in (text := path.read_text(encoding='utf-8'))}
    called = {one for name, text in kernels.items() for one in modules_imported(text, name)
              if one in kernels}
    assert {'friction.py', 'dynamics/vectors.py'} <= called
    assert [name for name in called if name not in KERNELS
            and name.partition('/')[0] not in KERNELS] == []


@pytest.mark.parametrize(('module', 'source', 'complaint'), [
    ('friction.py', 'from gms_flex_control.simulation import plant', 'above friction'),
    ('friction.py', 'from gms_flex_control import simulation', 'above friction'),
    ('dynamics/chain.py', 'from ..simulation.plant import step', 'above dynamics'),
    ('data/recording.py', 'from ..cli.main import main', 'above data'),
    ('control/cascade.py', 'import rclpy.node', 'belongs under nodes/'),
    ('tuning/tracking.py', 'def f():\n    from std_msgs.msg import String', 'under nodes/'),
    ('tuning/tracking.py', 'if True:\n    from mcap.reader import x', 'under data/'),
    ('cli/demo.py', 'from gms_flex_control.nodes import ros', 'outside a function'),
    ('cli/demo.py', 'def run(args):\n    from bench.speed import timing', 'not installed'),
    ('novel/part.py', '', 'no place in LAYERS'),
])
def test_a_forbidden_import_is_found(module, source, complaint):
    assert any(complaint in line for line in complaints(source, module))


# a nuisance parameter that an effect of equal name replaces; what MuJoCo has for each effect;
# examples of commands
ALLOWED = {'discrepancy/nuisance.py': {'viscous_asymmetry'},
           'params/robot.py': {'viscous_asymmetry'},
           **dict.fromkeys(('schema/mujoco.py', 'cli/verbs.py'),
                           set(registry.names()))}


def effects_named(source):
    """Yield the effects a module names as string or identifier; no docstrings, no imports."""
    tree, known = ast.parse(source), set(registry.names())
    prose = {id(node.body[0].value) for node in ast.walk(tree)
             if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef))
             and isinstance(node.body[0], ast.Expr)}
    for node in ast.walk(tree):
        words = [getattr(node, field, None) for field in ('id', 'attr', 'arg', 'name')]
        if isinstance(node, ast.Constant) and id(node) not in prose:
            words.append(node.value)
        for word in words:
            if isinstance(word, str):
                yield from known.intersection(re.findall(r'\w+', word))


def test_an_effect_is_named_in_the_catalogue_only():
    """It declares what is particular about it; whoever needs that one imports its class."""
    for module, path in MODULES.items():
        if not module.startswith('effects/catalogue/'):
            named = set(effects_named(path.read_text('utf-8')))
            assert named <= ALLOWED.get(module, set()), module


def test_a_name_of_an_effect_is_found():
    assert set(effects_named('"""A docstring on backlash."""\nx = {"of backlash": encoder_skew}')
               ) == {'backlash', 'encoder_skew'}
    source = 'from gms_flex_control.effects.catalogue.link import EndStop\nx = EndStop.name'
    assert not set(effects_named(source))


def test_the_drawing_in_the_documents_is_that_of_the_layers():
    """The one in the documents has all rows."""
    path = ROOT.parent / 'scripts' / 'draw_architecture.py'
    spec = util.spec_from_file_location('draw_architecture', path)
    drawing = util.module_from_spec(spec)
    spec.loader.exec_module(drawing)
    committed = drawing.PICTURE.read_text(encoding='utf-8')
    assert re.findall('weight="bold">(.*?)<', committed) == [*reversed(drawing.layers())]
