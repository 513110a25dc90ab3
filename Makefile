# Every target sets itself up: the first call makes .venv and installs edream with pinned packages, later calls use it at once.
PYTHON ?= python3
RUN := .venv/bin
PEER := runs/peers
NODE := .venv-node
DEMO := runs/reproduce
export OMP_NUM_THREADS ?= 1

.PHONY: reproduce policy-tiny policy-paper policy-seeds policy-table policy-physics dream-tiny bench-dream test slow recovery faults fuzz docs bench-scale bench-calibrate bench-steps check check-lerobot check-mcap blind blind-slice clean

# The whole way on a make-believe robot with an effect hidden in it, at the sizes of conf/experiment/tiny.yaml: an expert's demonstrations and
# free motions are recorded; calibrated (beside annealing) and diagnosed on the motions; video dreamed and a policy trained on the demonstrations;
# everything judged in the stand-in reality; one page about it all. Called again, or after a kill, it finds what is there. REPRODUCE adds settings.
REPRODUCE ?=
HIDDEN := load_friction
WHOLE = experiment=tiny seed=1 runs=$(DEMO)/runs $(REPRODUCE)
MOTIONS = robot=arm6 data=$(DEMO)/motions
DEMOS = robot=arm6_working data=$(DEMO)/demos camera.file=$(DEMO)/demos.cameras.json render.scene=$(DEMO)/demos.scene.json
TASK = task=grab_paper_cup rollouts.plate=$(DEMO)/demos.plate.png masks.plate=$(DEMO)/demos.plate.png
# where a run keeps the weights of its SFT, from which changed scenes go on: the folder of runs, the run's name
begun = $(1)/sft/$$(sed -n 's/.*"sft": "\([0-9a-f]*\)".*/\1/p' $(1)/run-$(2).json)
CHANGED = sft sft.start=$(call begun,$(DEMO)/runs,begun) sft.change.share=0.5 sft.train.steps=2000 sft.train.rate=0.0005 sft.train.average=0.998
reproduce: .venv/ready
	test -f $(DEMO)/demos.truth.json || { rm -rf $(DEMO)/demos $(DEMO)/demos.*; $(RUN)/edream record $(WHOLE) task=grab_paper_cup "record.effects=[$(HIDDEN)]" record.out=$(DEMO)/demos; }
	test -f $(DEMO)/motions.truth.json || { rm -rf $(DEMO)/motions; $(RUN)/edream record $(WHOLE) record.truth=$(DEMO)/demos.truth.json record.out=$(DEMO)/motions; }
	$(RUN)/edream calibrate $(WHOLE) $(MOTIONS) "fit.compare=[annealing]" run=reproduce-1-calibrate
	$(RUN)/edream diagnose $(WHOLE) $(MOTIONS) run=reproduce-2-diagnose
	$(RUN)/edream dream $(WHOLE) $(DEMOS) $(TASK) run=reproduce-3-dream
	$(RUN)/edream train-policy $(WHOLE) $(DEMOS) $(TASK) 'evaluate.of=[sft]' evaluate.starts=10 evaluate.films=0 run=begun
	$(RUN)/edream train-policy $(WHOLE) $(DEMOS) $(TASK) "evaluate.of=[sft,'$(CHANGED)',rl]" run=reproduce-4-policy
	$(RUN)/edream train-policy $(WHOLE) $(DEMOS) $(TASK) "evaluate.of=[sft,'$(CHANGED)']" evaluate.paper=horizontal run=reproduce-5-changed
	$(RUN)/edream report --whole reproduce --truth $(DEMO)/demos.truth.json runs=$(DEMO)/runs

# A make-believe robot is filmed, its simulator calibrated, and renderings are turned into video like its camera's: 12 minutes on 2 cores.
TINY := runs/dream-tiny
dream-tiny: export OMP_NUM_THREADS = 2
dream-tiny: .venv/ready
	test -d $(TINY)/recorded || $(RUN)/edream record robot=pan_tilt record.out=$(TINY)/recorded seed=1 \
	  record.video=true record.rate=15 record.motions=24 record.seconds=6.4
	$(RUN)/edream dream robot=pan_tilt data=$(TINY)/recorded runs=$(TINY)/runs run=dream-tiny seed=1 render.rate=null \
	  camera.file=$(TINY)/recorded.cameras.json render.scene=$(TINY)/recorded.scene.json masks.truth=$(TINY)/recorded.truth.masks.npz

# Fifty demonstrations by an expert on a make-believe robot, its simulator calibrated while a policy is trained on them, which then learns from
# its own trials; both judged over 200 starts in the stand-in reality. Another robot, other demonstrations: SEED=2 POLICY=runs/policy-tiny-2.
POLICY ?= runs/policy-tiny
STORE ?= $(POLICY)/runs
NAME ?= policy-tiny
SEED ?= 1
PRACTICE = robot=arm6_working task=grab_paper_cup data=$(POLICY)/recorded runs=$(STORE) seed=$(SEED) \
  rollouts.eyes=composite sft.twins=true rank.margin=1 camera.file=$(POLICY)/recorded.cameras.json \
  rollouts.plate=$(POLICY)/recorded.plate.png render.scene=$(POLICY)/recorded.scene.json
policy-tiny: export OMP_NUM_THREADS = 1
policy-tiny: .venv/ready
	test -f $(POLICY)/recorded.truth.json || { rm -rf $(POLICY)/recorded $(POLICY)/recorded.*; $(RUN)/edream record robot=arm6 task=grab_paper_cup record.episodes=50 record.out=$(POLICY)/recorded seed=$(SEED); }
	$(RUN)/edream calibrate $(PRACTICE) run=calibrate-$(NAME) & $(RUN)/edream train-policy $(PRACTICE) run=$(NAME); made=$$?; wait; exit $$made

# The same five times from the recording on, with five hidden robots: mean and spread on one page. About 20 minutes each on 2 free cores.
MANY := runs/policy-seeds
policy-seeds: $(foreach seed,1 2 3 4 5,policy-seeds-$(seed))
	$(RUN)/edream report --whole policy-seeds runs=$(MANY)/runs

policy-seeds-%: .venv/ready
	$(MAKE) policy-tiny SEED=$* POLICY=$(MANY)/$* STORE=$(MANY)/runs NAME=policy-seeds-$*

# The policy of policy-tiny that looks (sft.hidden), the same gone on with changed scenes, and both after RL: on the bench as it was, and with a
# sheet of A4 paper on it that no demonstration has shown. Another robot: make policy-paper SEED=4 POLICY=runs/policy-seeds/4 STORE=runs/policy-seeds/runs.
LOOKS = $(RUN)/edream train-policy $(PRACTICE) sft.hidden=0.5
GONE_ON = sft.start=$(call begun,$(STORE),looks-$(SEED)) sft.change.share=0.5 sft.train.steps=6000 sft.train.rate=0.0005 sft.train.average=0.998
BOTH = "evaluate.of=[\"sft\",\"rl\",\"sft $(GONE_ON)\",\"rl $(GONE_ON)\"]"
policy-paper: export OMP_NUM_THREADS = 1
policy-paper: .venv/ready
	test -f $(POLICY)/recorded.truth.json || { rm -rf $(POLICY)/recorded $(POLICY)/recorded.*; $(RUN)/edream record robot=arm6 task=grab_paper_cup record.episodes=50 record.out=$(POLICY)/recorded seed=$(SEED); }
	$(LOOKS) 'evaluate.of=["sft"]' run=looks-$(SEED)
	$(LOOKS) $(BOTH) run=policy-paper-$(SEED)
	$(LOOKS) $(BOTH) evaluate.paper=horizontal run=policy-paper-horizontal-$(SEED)

# The paper's table at the tiny size: four tasks, SFT with three views, SFT with one, RL with one. Then the ablation: RL under physics as
# published, calibrated, and calibrated with the effects that diagnosis found, on one robot that hides four, by policies that read poses and not
# images (state mode): one that sees its hand makes up for a simulator that has it elsewhere; six rounds of RL, as a fourth still helped in the
# diagnosed simulator. Hours on 2 cores, but it can be stopped at any time: called again, it goes on. One task or less: make policy-table
# TASKS=put_cup_on_mat ROWS='["sft","rl"]'. Another hidden robot and other demonstrations: make policy-table SEED=2 TABLE=runs/policy-table-2.
TABLE := runs/policy-table
TASKS ?= grab_paper_cup put_pen_in_cup put_remote_in_box put_cup_on_mat
ROWS ?= ["sft policy.cameras=[cam_high,cam_side,wrist] sft.twins=false","sft","rl"]
STARTS ?= 500
PHYSICS ?= ["sft","rl rollouts.model=published","rl","rl rollouts.model=diagnose"]
LEARN = $(RUN)/edream train-policy robot=arm6_working seed=$(SEED) runs=$(TABLE)/runs
BY_SIGHT = rollouts.eyes=composite sft.twins=true rank.margin=1 'policy.cameras=[cam_high]'
BY_STATE = 'policy.cameras=[]' policy.objects=$(1).scene.json
define demonstrated  # task, folder, further settings
	test -f $(2).truth.json || { rm -rf $(2) $(2).*; $(RUN)/edream record robot=arm6 task=$(1) record.episodes=50 record.out=$(2) seed=$(SEED) $(3); }
endef
VIEWS := 'record.cell.cameras=[cam_high,cam_side,wrist]'
HIDES := 'record.effects=[gear_ratio,gear_ratio,load_friction,actuator_delay]' 'record.at=[joint2,joint3]'
ROBOT := $(TABLE)/grab_paper_cup-hiding
MOVED := $(TABLE)/hiding-motions
ON_MOTIONS = 'rollouts.physics="data=$(1)"'
define moved  # the truth of a robot, folder of its free motions
	test -f $(2).truth.json || { rm -rf $(2); $(RUN)/edream record robot=arm6 record.truth=$(1) record.out=$(2) seed=$(SEED); }
endef
BESIDE = data=$(1) camera.file=$(1).cameras.json rollouts.plate=$(1).plate.png render.scene=$(1).scene.json
policy-table: $(TASKS:%=policy-table-%)
	$(RUN)/edream report --whole policy-table runs=$(TABLE)/runs

policy-table-%: .venv/ready
	$(call demonstrated,$*,$(TABLE)/$*,$(VIEWS))
	$(LEARN) $(BY_SIGHT) task=$* $(call BESIDE,$(TABLE)/$*) 'evaluate.of=$(ROWS)' run=policy-table-$*

policy-physics: $(TASKS:%=policy-physics-%)
	$(RUN)/edream report --whole policy-physics runs=$(TABLE)/runs

policy-physics-%: .venv/ready
	$(call demonstrated,grab_paper_cup,$(ROBOT),$(HIDES))
	$(call moved,$(ROBOT).truth.json,$(MOVED))
	$(call demonstrated,$*,$(TABLE)/$*-hiding,record.truth=$(ROBOT).truth.json)
	$(LEARN) $(call BY_STATE,$(TABLE)/$*-hiding) task=$* $(call BESIDE,$(TABLE)/$*-hiding) $(call ON_MOTIONS,$(MOVED)) rl.rounds=6 evaluate.films=0 evaluate.starts=$(STARTS) 'evaluate.of=$(PHYSICS)' run=policy-physics-$*

# A task of the table once more, by sight: SFT with twins, and RL, in the calibrated simulator and in the one that diagnosis finds on free motions
# of the same robot: make policy-diagnosed-put_remote_in_box SEED=2 TABLE=runs/policy-table-2.
DIAGNOSED := ["sft","rl","sft rollouts.model=diagnose","rl rollouts.model=diagnose"]
policy-diagnosed-%: .venv/ready
	$(call demonstrated,$*,$(TABLE)/$*,$(VIEWS))
	$(call moved,$(TABLE)/$*.truth.json,$(TABLE)/$*-motions)
	$(LEARN) $(BY_SIGHT) task=$* $(call BESIDE,$(TABLE)/$*) $(call ON_MOTIONS,$(TABLE)/$*-motions) 'evaluate.of=$(DIAGNOSED)' run=policy-diagnosed-$*

bench-dream: .venv/ready
	$(RUN)/python -m benchmarks.bench_dream

# Two processes: most tests keep one core busy.
TESTS := -n 2 --dist worksteal
test: .venv/ready
	$(RUN)/python -m pytest -m "not slow" -q $(TESTS) --durations=20 --durations-min=5

slow: .venv/ready
	$(RUN)/python -m pytest -m slow -q

# Planted truth on arm6: 24 numbers, 20 seeds, how many lie inside their 95 % interval.
recovery: .venv/ready
	$(RUN)/python -m pytest -q -s -m "slow or not slow" tests/recovery

# Kills at random moments and at every point of every write, processes at once, flipped bits, full and read-only disks, a clock that jumps: on small
# stages and on the real ones. FAULT_KILLS says how many at random moments.
FAULT_KILLS ?= 300
faults: .venv/ready
	EDREAM_FAULT_KILLS=$(FAULT_KILLS) $(RUN)/python -m pytest -q -s -m "slow or not slow" tests/faults

# Recordings of every format, broken in every way, for FUZZ_MINUTES each; FUZZ adds words such as "--format rlds --seed 100000".
FUZZ_MINUTES ?= 1
FUZZ ?=
fuzz: .venv/ready
	$(RUN)/python -m tests.fuzz --minutes $(FUZZ_MINUTES) $(FUZZ)

# The documentation as pages, runs/site/index.html; a broken link is an error.
docs: .venv/ready-docs
	$(RUN)/mkdocs build --strict --quiet

# Memory and time of ingest and sweep at 10, 100 and 1000 episodes.
bench-scale: .venv/ready
	$(RUN)/python benchmarks/bench_scale.py

# Our ways to fit against annealing, CMA-ES and mujoco.sysid: one loss, one data set, error and time as ratios. An hour or so.
# Words for it, such as BENCH="--case arm6 --method gauss_newton".
BENCH ?=
bench-calibrate: .venv/ready-bench
	$(RUN)/python benchmarks/bench_calibrate.py $(BENCH)

# Steps per second of the sweep against a bare C loop over the same model.
bench-steps: .venv/ready
	$(RUN)/python benchmarks/bench_steps.py

check: .venv/ready-dev
	$(RUN)/ruff check edream tests
	$(RUN)/pyright --pythonpath $(RUN)/python
	$(RUN)/python -m pytest -q tests/test_house.py

.venv/ready: pyproject.toml constraints.txt
	test -x $(RUN)/pip || $(PYTHON) -m venv --clear .venv  # one that was killed half made is made anew
	$(RUN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test]"
	touch $@

.venv/ready-dev: .venv/ready
	$(RUN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test,dev]"
	touch $@

.venv/ready-docs: .venv/ready
	$(RUN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test,docs]"
	touch $@

.venv/ready-bench: .venv/ready
	$(RUN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e ".[test,bench]"
	touch $@

# Our LeRobot export in the real client, which lives in an environment of its own.
check-lerobot: .venv/ready .venv-lerobot/ready
	rm -rf $(PEER)
	$(RUN)/edream record robot=pan_tilt record.out=$(PEER)/recorded record.motions=3 record.seconds=4
	$(RUN)/edream export --out $(PEER)/lerobot robot=pan_tilt data=$(PEER)/recorded runs=$(PEER)/runs
	.venv-lerobot/bin/python tests/peers/check_lerobot.py $(PEER)/lerobot

# Our episode files in the TypeScript implementation of MCAP: streamed and indexed, all checksums on. Needs node and npm.
check-mcap: .venv/ready $(NODE)/ready
	rm -rf $(PEER)
	$(RUN)/edream record robot=pan_tilt record.out=$(PEER)/recorded record.motions=3 record.seconds=4
	$(RUN)/edream ingest robot=pan_tilt data=$(PEER)/recorded runs=$(PEER)/runs
	node tests/peers/mcap_check.mjs $(NODE) $(PEER)/runs/ingest/*/episodes/*.mcap

.venv-lerobot/ready:
	test -x .venv-lerobot/bin/python || $(PYTHON) -m venv .venv-lerobot
	.venv-lerobot/bin/pip install --quiet --disable-pip-version-check torch==2.13.0 lerobot-dataset==0.4.4
	.venv-lerobot/bin/pip install --quiet --disable-pip-version-check --no-deps torchvision==0.25.0
	touch $@

$(NODE)/ready:
	mkdir -p $(NODE)
	npm install --silent --prefix $(NODE) @mcap/core@2.2.2 @mcap/support@1.1.0 @mcap/nodejs@1.0.2
	touch $@

# Words for the blind tests, such as BLIND="--robots pan_tilt --seeds 1 --baselines"; finished cases are kept under runs/blind.
BLIND ?= --seeds 3
blind: .venv/ready
	$(RUN)/python -m benchmarks.blind $(BLIND)

blind-slice: .venv/ready
	$(RUN)/python -m pytest -q tests/blind

clean:
	rm -rf .venv .venv-lerobot .venv-node runs/peers runs/reproduce runs/dream-tiny runs/policy-tiny runs/policy-seeds runs/policy-table
