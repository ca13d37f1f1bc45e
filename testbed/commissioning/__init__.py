"""An aircraft from elsewhere: import, first gains, flight tests, variants, fits to recordings.

`new_aircraft` is the command `testbed new aircraft`: `airframe_import` copies the files, which
`airframes` checks, `first_gains` derives the gains by rule, and `check_flight` flies a minute with
them. `airframe_fit` and `replay_commands` compare an aircraft with a recording.
"""
