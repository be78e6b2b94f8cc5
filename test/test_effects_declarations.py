# Copyright 2026 The gms_flex_control authors; Apache License, Version 2.0.
"""What effects declare of themselves, those of the catalogue and those of other packages."""

from dataclasses import replace

from bench.hidden_robots.cases import make_case
from core_runs import effect_on, push_plant
from discrepancy_runs import likelihood_of
from gms_flex_control.discrepancy.dictionary import guesses_of
from gms_flex_control.discrepancy.remainder import VARIABLES
from gms_flex_control.effects import registry
from gms_flex_control.effects.base import Scales, Stage, Term, Travel
from gms_flex_control.effects.catalogue.friction_level import ViscousError
from gms_flex_control.errors import ParameterError
import numpy as np
import pytest

pytestmark = pytest.mark.fast

SCALES = Scales(friction=0.1, torque=0.5, spring=0.3, torsion=0.2, speed=0.5, inertia=0.005,
                link_inertia=0.1, travel=Travel(-1.0, 1.0, 2.0), duration=20.0, supply=12.0,
                mass=2.5)


@pytest.mark.parametrize('name', registry.names())
def test_what_an_effect_declares_is_consistent(ideal_robot, name):
    """
    Mutual exclusion, bounds of the search within those of the model, usual sizes in them.

    And what it shows against and is confused with.
    """
    kind = registry.find(name)
    assert kind.evidence in VARIABLES
    assert kind.discriminated_by and not kind.discriminated_by.endswith('.')
    for other in kind.similar:
        assert other != name and name in registry.find(other).similar
    for rigid in (False, True):
        for other in kind.excludes(rigid):
            assert other != name and name in registry.find(other).excludes(rigid)
    usual = kind.typical(SCALES)
    assert len(usual) == len(kind.parameters)
    for joint in range(1 if kind.whole_arm else 2):
        lower, upper = kind.search_bounds(joint, ideal_robot)
        for one, low, high, size in zip(kind.parameters, lower, upper, usual, strict=True):
            assert one.lower <= low < high <= one.upper
            assert one.fixed <= (size is None)
            assert size is None or (size > 0.0 and low < size < high)
    assert not (kind.whole_arm and kind.replaces)
    if issubclass(kind, Term) and kind.stage == Stage.SENSOR:  # torque has a time as well
        assert kind.needs_link_encoder or name == 'recording_delay'


@pytest.mark.parametrize('name', registry.names())
def test_sizes_an_effect_is_looked_for_with_follow_the_machine(name):
    """A machine a thousand times as strong is looked at with torques a thousand times as large."""
    large = SCALES._replace(**{field: 1e3 * getattr(SCALES, field) for field in (
        'friction', 'torque', 'spring', 'inertia', 'link_inertia', 'mass')})
    kind = registry.find(name)
    for one, small, big in zip(kind.parameters, kind.typical(SCALES), kind.typical(large),
                               strict=True):
        factor = 1e3 if one.unit.startswith(('N m', 'kg')) else 1.0
        assert (small is None and big is None) or big == pytest.approx(factor * small)


MODULE = """
from gms_flex_control.effects.base import Parameter, Stage, Term
from gms_flex_control.effects.base import linear
from gms_flex_control.effects.base import DQ_LINK, FRICTION


class CableDrag(Term):
    name = 'cable_drag'
    stage = Stage.FRICTION
    evidence = 'link rate'
    similar = ()
    discriminated_by = 'the same motion without the cable'
    parameters = (Parameter('slope', 'N m s/rad', 'slope'),)

    @classmethod
    def guesses(cls, scales):
        return linear(0.1 * scales.friction / scales.speed)

    @classmethod
    def typical(cls, scales):
        return (0.3 * scales.friction / scales.speed,)

    @staticmethod
    def apply(s, p, memory, dt):
        s[FRICTION] += p[0] * s[DQ_LINK]
"""
OFFERED = {'cable_drag': 'cable_package:CableDrag', 'backlash': 'cable_package:CableDrag',
           'cable': 'cable_package:CableDrag', 'torn': 'no_such_package:Torn',
           'number': 'cable_package:DQ_LINK'}


@pytest.fixture
def offered(tmp_path, monkeypatch):
    """Install a package that offers an effect, and some that are none."""
    (tmp_path / 'cable_package.py').write_text(MODULE)
    info = tmp_path / 'cable_package-1.0.dist-info'
    info.mkdir()
    (info / 'METADATA').write_text('Metadata-Version: 2.1\nName: cable_package\nVersion: 1.0\n')
    (info / 'entry_points.txt').write_text('\n'.join([
        f'[{registry.GROUP}]', *(f'{name} = {value}' for name, value in OFFERED.items())]))
    monkeypatch.syspath_prepend(tmp_path)
    kept = (registry._offered, registry.names, registry.find)
    for one in kept:
        one.cache_clear()
    yield
    for one in kept:
        one.cache_clear()


def test_an_effect_of_another_package_moves_the_plant(offered, ideal_robot):
    """As one of the catalogue with the same equation, to the bit."""
    command = 0.3 * np.sin(np.arange(400)[:, None] * [0.01, 0.02])
    runs = [push_plant(replace(ideal_robot, effects=effects), command, 2e-3, substeps=4)
            for effects in ((), *((effect_on('joint1', name, 0.2),)
                                  for name in ('cable_drag', ViscousError.name)))]
    assert np.abs(runs[0] - runs[1]).max() > 1e-3
    np.testing.assert_array_equal(runs[1], runs[2])


def test_the_search_looks_for_an_effect_of_another_package(offered):
    likelihood = likelihood_of(make_case('clean', 0, duration=5.0))
    excluded = set(registry.names()) - {'cable_drag'}
    assert [guess[:2] for guess in guesses_of(likelihood, excluded)] == [
        ('cable_drag', 'joint1'), ('cable_drag', 'joint2')]


@pytest.mark.parametrize(('name', 'why'), [
    ('backlash', 'has the name of one of the catalogue; rename it'),
    ('cable', "calls itself 'cable_drag'; both names must agree"),
    ('torn', "cannot be loaded (ModuleNotFoundError: No module named 'no_such_package'); mend or"),
    ('number', 'is not a subclass of gms_flex_control.effects.base.Term or Change')])
def test_what_is_no_effect_is_refused_in_one_sentence(offered, name, why):
    with pytest.raises(ParameterError) as refused:
        registry.find(name)
    assert str(refused.value).startswith(
        f'effect {name!r}, offered as {OFFERED[name]!r} in the entry points {registry.GROUP}, ')
    assert why in str(refused.value)
