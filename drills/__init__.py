"""Drills: what must not happen to people, tried out until it does. `make drill` runs all, `python -m drills NAME` one.

A drill is a file here with a DRILL: something prepared once, and trials that each depend on nothing but the seed and
their own number, so that any can be repeated alone. Faults are counted in four kinds (see drills.common.Fault).
"""
