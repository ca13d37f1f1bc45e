# Commands of the folder paper, included by the Makefile of the repository. Its scripts share modules with
# those of benchmarks.
PAPER = PYTHONPATH=benchmarks $(BIN)/python paper

# Flies the studies of paper/gap.md into logs/studies/gap, resuming interrupted ones, and writes its tables
# and figures: 216 flights, a quarter of an hour on two quiet cores (ARGS="--only joint-fit" for a part).
gap: $(STAMP)
	@$(PAPER)/gap_budget.py --jobs $(JOBS) --into paper/gap.md $(ARGS)

# Flies one row per choice that the paper leaves open: a table of docs/results/simulations.md.
freedoms: $(STAMP)
	@$(PAPER)/freedoms.py --into docs/results/simulations.md $(ARGS)

# Flies the set-ups of the simulations beside Table 1: the tables of paper/leader-acceleration.md.
leader-acceleration: $(STAMP)
	@$(PAPER)/leader_acceleration.py --into paper/leader-acceleration.md $(ARGS)

.PHONY: gap freedoms leader-acceleration
