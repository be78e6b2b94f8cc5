# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""Presliding amplitudes follow the break-away torque that was found, not the expected one."""

_LEAST, _MOST = 0.2, 3.0  # of what was planned
LEAVING = 0.2  # of the travel that ends a break-away step: there it begins
_CAUTION = 0.85    # the torque found is late by what inertia takes, and differs each time


class Adaptation:
    """
    What the break-away steps have found, and what follows for presliding.

    Parameters
    ----------
    plan : IdentificationPlan
        The steps and the expected static friction.
    found : dict of str to float, optional
        Least torque at break-away by joint, from an earlier run [N m]; changed in place.

    """

    def __init__(self, plan, found=None):
        self._plan, self.found = plan, {} if found is None else found

    def broke_away(self, step, time):
        """
        Note that a break-away step ended.

        Parameters
        ----------
        step : Step
            Of phase break_away.
        time : float
            When the joint had not yet moved by `LEAVING` of the step's travel, from the step's
            beginning [s].

        Returns
        -------
        float
            The torque then, without what holds the arm against gravity [N m].

        """
        j = self._plan.joints.index(step.joint)
        bias = step.trajectory_parameters[f'trajectory.{step.joint}.bias']
        trajectory = self._plan.trajectory(step)
        top_time = 0.5 * trajectory.end  # it rises, then falls
        torque = abs(trajectory.sample(min(time, top_time))[0, j] - bias)
        self.found[step.joint] = min(float(torque), self.found.get(step.joint, float(torque)))
        return torque

    def applied_to(self, step):
        """
        Return a step as it is to be carried out.

        Parameters
        ----------
        step : Step
            Of the plan.

        Returns
        -------
        Step
            Presliding with its levels scaled by found over expected break-away torque, within
            the joint's torque limit; any other step unchanged.

        """
        if step.phase != 'presliding' or step.joint not in self.found:
            return step
        j = self._plan.joints.index(step.joint)
        factor = _CAUTION * self.found[step.joint] / self._plan.static[j]
        factor = min(max(factor, _LEAST), _MOST)
        name = f'trajectory.{step.joint}.levels'
        bias = abs(step.trajectory_parameters[f'trajectory.{step.joint}.bias'])
        factor = min(factor, (self._plan.torque[j] - bias) / step.value)
        levels = [factor * level for level in step.trajectory_parameters[name]]
        return step._replace(trajectory_parameters=step.trajectory_parameters | {name: levels},
                             value=factor * step.value)
