"""Fuzzing of everything that reads what others wrote: bytes of links, files, answers.

A harness is a function of bytes that raises when a property does not hold. `tests/fuzz` runs each
on its seeds and with hypothesis; `python -m benchmarks.reliability.fuzz` runs them for long.
"""
