"""Every setting: what it means, where its value comes from, and the presets.

Nothing here loads USD, OpenVDB or torch.

- ``look_sections``: views, opacity, style, features, losses, the shape step and the colour step
- ``run_sections``: what is read of the stage and the files, windows, the optimiser, what is written
- ``setting_model``: what a setting is: default, limits, unit, meaning
- ``settings``: all sections of a run, and which settings are explicit
- ``resolve``: settings from files, mappings and texts, in order of precedence
- ``presets``: settings files for a purpose
"""

__all__: list[str] = []
