"""The command line.

- ``main``: arguments in, one call of the package, results out; exit codes and signals
- ``arguments``, ``record_arguments``, ``values``, ``parser``: what each command takes
- ``work_commands`` (stylize, submit, assemble), ``commands`` (all others): one call of the package
  each
- ``text``, ``record_text``: what they print
- ``progress_bar``: how far a run is
"""
