"""Audits a map: compares it with the best map of the same points, and combines the results of its tests into a verdict.

A sweep is a scan, or the points of a finished cloud that were seen in the time of one scan. The tests judge windows (a few
successive sweeps), steps (the places between two successive sweeps), spans (some tens of metres of path) and revisits (two
passes of one place). Such a part of a map is torn if it is off by more than chance explains and by more than is tolerated.
"""
