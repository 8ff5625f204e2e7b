"""Work-precision diagrams of a scene: what each choice around the configured ones gains and costs.

``run.make_report`` is what the command calls. Every sweep is a module of its own that says whether
a scene has any use for it and which points it wants; ``engine`` takes them until the time is used,
``conclude`` says what the figures mean, ``diagrams`` and ``page`` draw and write it.
"""
