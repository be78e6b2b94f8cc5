# Copyright 2026 The gms_flex_control authors
#
# Licensed under the Apache License, Version 2.0; see the LICENSE file.
"""The part of a discrepancy's report on the closed loop simulated anew."""

from gms_flex_control.reports.page import Series


def add_closed_loop(report, again):
    """
    Add table and charts to a report.

    Parameters
    ----------
    report : Report
        The page.
    again : ClosedLoop or None
        Of the gap; nothing is added for None.

    """
    if again is None:
        return
    report.heading('The closed loop, simulated anew')
    report.text('Model and controller follow the recorded reference once more; each figure is how '
                'far the simulated link angle is from the measured one. The controller believes '
                'the model as given, as it did on the robot. The floor is what two runs of the '
                'final model differ by when their encoder noise does.')
    report.table(
        ('joint', 'as given [mrad]', 're-tuned [mrad]', 'with the effects [mrad]',
         'floor [mrad]'),
        [(joint, *(f'{1e3 * value[j]:.3g}' for value in (
            again.before, again.retuned, again.after, again.floor)))
         for j, joint in enumerate(again.joints)],
        f'Simulated less measured link angle, rms, over {", ".join(again.sources)}')
    for j, joint in enumerate(again.joints):
        report.chart(f'{joint}: closed loop, simulated - measured', again.time, [
            Series(name, 1e3 * (course[:, j] - again.measured[:, j]), role=role)
            for name, course, role in (('before', again.course_before, 'c1'),
                                       ('after', again.course_after, 'c0'))],
            y_label='angle [mrad]')
