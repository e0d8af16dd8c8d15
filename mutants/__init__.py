"""Mutants: what the tests are worth. `make mutants` breaks the package in one place after another and sees that each
time a test fails; table.py names the places, and which tests are to notice.
"""
