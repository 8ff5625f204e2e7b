"""Golden results: small runs of usdsmoke whose voxels, layers and pictures are on record.

A change of the code's structure must not change a bit of what usdsmoke writes. ``runs`` lists small
runs that together pass through every part of the product. ``golden.json`` holds what they gave.
``test_golden`` makes the runs again and compares.

    python -m pytest tests/baselines                     all runs, compared with the record
    python -m tests.baselines --only slab --only mask    some runs, compared with the record
    python -m tests.baselines --write                    replace the record; see below
    python -m tests.baselines --write FILE               record into another file
    python -m tests.baselines --against FILE             compare with another record

Floating-point results depend on the processor, torch and NumPy. The record names the circumstances
of each set of hashes. Under the same circumstances every hash must be equal. Under other
circumstances sums, centres of mass and block means must agree within the tolerances of
``record``: 1e-3, and more for what an optimisation leads to. To check a change bit by
bit on another machine, record the revision before the change there and compare with that file:

    git worktree add /tmp/before REVISION
    PYTHONPATH=/tmp/before python -m tests.baselines --write /tmp/before.json
    python -m tests.baselines --against /tmp/before.json

``--write`` keeps the hashes of other circumstances if the statistics still agree. It drops them if
the results have changed. A changed result needs a record in docs/decisions.

The runs use the command line alone, and read results with USD, OpenVDB and Pillow. They import no
module of usdsmoke, so that they hold however its files are arranged. ``look`` is another guard: a
small look, drawn and compared with ``look.png`` by edges, detail and colours. It calls the core.
"""

__all__: list[str] = []
