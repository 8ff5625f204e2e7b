"""The command line.

- ``main``: arguments in, one call of the package, results out; exit codes and signals
- ``arguments``, ``record_arguments``, ``values``: what each command takes
- ``work_commands`` (stylize, submit, assemble), ``look_commands`` (inspect, validate, settings,
  plugin-path), ``preview_command``, ``record_commands`` (provenance, verify, rerun),
  ``report_command``: one call of the package each
- ``text``, ``budget_text``, ``record_text``, ``request_text``: what they print
- ``progress_bar``: how far a run is
"""
