"""Flight models compiled from the aircraft's own JSBSim files, equal to JSBSim to the bit.

`CompiledAircraft` translates the files of one aircraft folder, for one set of integrators, to one
function of rows of numbers. A row (S,) is the state of one aircraft: mostly JSBSim's properties, in
JSBSim's units; `columns` has their names. Rows of a kind are one array (M, S), so that copying a
row is a reset. Mass, inertia, centre of gravity, offset of the air's temperature and properties
such as `battery/cells` are columns and may differ from row to row.

JSBSim loads, trims and places the aircraft:

    model = load(folder, rate_hz, integrators)
    aircraft = CompiledAircraft(folder, model, integrators)
    aircraft.watch(model)
    model.place(...)
    state[i] = aircraft.row_of(model)

`aircraft.run_rows` is an entry, for `bind_entry` or `Call`:

    run_rows(state, wind, controls, first, changed, dt, ticks, which, status)

    state      (M, S) float64, read and written
    wind       (M, 7) numbers of `jsbsim_io.pack_wind`: ft/s, rad/s, change of the roll coefficient
    controls   (M, 4) numbers of `jsbsim_io.pack_surfaces`
    first      (M, 4) controls of the first step, of `jsbsim_io.lead_controls`
    changed    (2,) bool, `jsbsim_io.WIND` and `CONTROLS`: the numbers above are written to the
               rows; those that have not changed are in the rows
    dt         s, one step
    ticks      (1,) steps, intp
    which      (K,) of the M rows, intp
    status     (M,) uint8, `model_limits`: 0 flying. A row that leaves what the model describes gets
               its code at the end of that step, and is not advanced any more. JSBSim itself goes
               on, in the layers above, or with numbers beyond all measure that end as NaN; a flight
               loses such an aircraft at its next tick. The ground's forces are not in the model:
               a flight loses an aircraft before a part of it touches the ground.

`rows.write_motion(state, which, numbers)` and
`rows.write_air(state, which, aircraft.air_columns, numbers)` are entries that write what
`jsbsim_io.write_truth` and `jsbsim_io.write_air` read.

Parts of aircraft that are not translated raise `NotTranslated`, with file, line and element:
`airframe_grammar` says which elements are.
"""

from testbed.compiled.compiled_aircraft import CompiledAircraft
from testbed.compiled.elements import NotTranslated

__all__ = ["CompiledAircraft", "NotTranslated"]
