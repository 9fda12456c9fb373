"""The safety case: hazards, claims and evidence (safety/case.toml), judged by what runs of these very files have left.

`make case` prints the tree. A claim is shown if all of its evidence is; it is red if some of it has failed, is gone or
was not run for these files; what only a person can show stands there as that.
"""
