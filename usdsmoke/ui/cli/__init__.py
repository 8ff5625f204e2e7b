"""The command line.

- ``main``: arguments in, one call of the package, results out; exit codes and signals
- ``arguments``, ``record_arguments``: what each command takes
- ``options``: what several commands take, and the settings that their options stand for
- ``parser``, ``values``: hints for misspelt words; numbers and sizes from text
- ``work_commands`` (stylize, submit, assemble), ``preview_command``, ``commands`` (all others): one
  call of the package each
- ``plan_text``, ``text``, ``budget_text``, ``record_text``: what they print
- ``progress_bar``: how far a run is
"""
