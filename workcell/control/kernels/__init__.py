"""The arithmetic of a tick as machine code: the same numbers as the NumPy files beside it, sooner.

A tick is some thousand calls into NumPy of a microsecond each; written pair by pair and compiled,
it is a few calls. The NumPy code in `proximity`, `second_order`, `ttc`, `criteria` and `ik` says what
is computed and stays in use wherever nothing is compiled; tests hold both to each other.

    source      the functions, pair by pair (imports numba)
    arguments   what each is handed: names, types, shapes
    build       source -> machine code in a file, by numba (`workcell compile`, `make install`)
    library     the file -> functions that can be called; chooses between the two

A run needs only `library`, which loads the file: numba itself, which takes more than a second to import, is
needed to compile and never in a run.
"""
