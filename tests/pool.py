#!/usr/bin/env python3
"""Builds the tests and runs all of them in one pool: tests/pool.py [--long | --zenoh] [-p PACKAGE]... [NAME]...

Each test is a process of its own, in one of the classes below: a test that waits has many slots, a test that computes has one for each
processor, and gives way to those that wait. NAME is a part of a test's name, as it is printed. `--long` runs what is left out
otherwise. `--zenoh` builds what no default build contains, and runs the tests of the bridge over zenoh. `./test` calls this after it has
installed what the tests need.
"""

import argparse
import contextlib
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

TOP = Path(__file__).resolve().parent.parent
TARGET = Path(os.environ.get("CARGO_TARGET_DIR", TOP / "target")).resolve()
PROFILE = "tests"
DURATIONS = TARGET / PROFILE / "durations.json"
PROCESSORS = os.cpu_count() or 1

# The classes of test binaries, with their slots. What is named nowhere computes, has one slot for each processor, and gives way.
CLASSES = {
    # They wait for nodes, leases and elections.
    "waiting": (3 * PROCESSORS, {"cli", "client", "clients", "cluster", "hostile", "inventory", "node"}),
    # They wait for graphs of ROS 2, whose many processes lose messages where processors are short.
    "graphs": (PROCESSORS, {"bridge", "interop", "ros_bridge", "ros_zenoh"}),
    "computing": (PROCESSORS, set()),
}
# Test binaries that start programs of this workspace.
WITH_PROGRAMS = {"cli", "clients", "cluster", "hostile", "interop", "node"}
# The longest ones begin first. What is not named here begins in the order of the last run's durations.
FIRST = ["sim::seeds::", "node::languages::", "node::crash::", "cluster::", "interop::"]
# Left out without --long.
LONG = [
    "interop::arena::the_arena_judges_its_claims",
    # They compile for minutes. CI runs both.
    "clients::languages::the_program_in_cpp",
    "node::packaging::one_command_makes_a_package",
]
# With --long these try more than without it.
LONGER = ["cluster::", "replica::chaos::", "sim::mutations::", "sim::seeds::no_storm"]
# One after the other, when all others have ended: they show what a machine without other work can do.
ALONE = [
    "repository::documents::the_first_command_of_the_readme_plays_the_experiment",
    # Bursts of large samples overflow the buffers of sockets where processors are short.
    "bridge::peers::images_of_",
]
# What --zenoh builds, each with its features for zenoh.
ZENOH = {"ledgerd-bridge-zenoh": "zenoh", "ros-bridge": "zenoh", "ros-zenoh": "session", "ros-zenoh-tests": "zenoh"}
# What it runs: the tests of zenoh, and those of routes and of whole networks whose subject is not DDS.
ZENOH_TESTS = [
    "ros_zenoh::",
    "ros_bridge::graph::choice::",
    "ros_bridge::graph::zenoh::",
    "ros_bridge::bridge::tests::",
    "interop::actions::the_holder_alone",
    "interop::calls::the_holder_alone",
    "interop::passing::a_command_above_the_limit",
    "interop::sharing::who_drives_changes",
    "interop::side_door::a_stranger_on_the_robots_topic",
    # Where a ROS 2 with rmw_zenoh_cpp is sourced.
    "interop::real_ros::",
]
# Not these: they wait for acknowledgements, or for endpoints that quality of service keeps apart, and zenoh has neither. Or they name DDS.
NO_ZENOH = [
    "ros_bridge::bridge::tests::a_ledger_that_is_slower",
    "ros_bridge::bridge::tests::latched_tests::a_route_hears_a_best_effort",
    "ros_bridge::bridge::tests::latched_tests::what_a_reader_has_heard",
    "ros_bridge::bridge::tests::shm_tests::",
]
# So many tests at most that have failed beside others are run once more, alone, if they are of a class that waits: real processes that
# share the processors with a hundred others lose races which people never see. The summary names them; each is a fault of a test, to be
# mended. What computes has no such excuse, and a run of few tests neither.
AGAIN_MAX, FEW = 3, 100
# Seconds after which a test has failed. One that computes gives way, so on a busy machine it takes long without a fault.
TIME_MAX, TIME_MAX_COMPUTING = 900, 2700
# The process groups of the tests that run.
RUNNING = set()


class Test:
    """A test, or all examples in the documentation as one."""

    def __init__(self, binary, name, command, directory, variables):
        self.name = f"{binary}::{name}"
        named = (of for of, (_, binaries) in CLASSES.items() if binary in binaries)
        self.of = next(named, "computing")
        self.command = ["nice", "-n", "10", *command] if self.of == "computing" else command
        self.directory, self.variables = directory, variables
        self.output, self.seconds = "", 0.0
        self.passed, self.failed, self.skipped = 0, 0, []

    def run(self):
        """Runs it; afterwards the counts, the output and the time are there."""
        begun = time.monotonic()
        with tempfile.TemporaryFile() as output:
            code = self.wait(subprocess.Popen(
                self.command, cwd=self.directory, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                env={**os.environ, **self.variables}, start_new_session=True))
            output.seek(0)
            self.output = output.read().decode(errors="replace")
        self.seconds = time.monotonic() - begun
        # A test that runs itself again in namespaces prints the inner result, too; the examples have one for each library.
        results = re.findall(r"^test result: \w+\. (\d+) passed; (\d+) failed;", self.output, re.M)
        results = results if self.name.startswith("documentation::") else results[-1:]
        self.passed, self.failed = (sum(int(result[place]) for result in results) for place in (0, 1))
        if self.failed == 0 and (code != 0 or self.passed == 0):
            self.failed = 1
        self.skipped = re.findall(r"^skipped: (.*)$", self.output, re.M) if self.failed == 0 else []
        return self

    def wait(self, process):
        """The exit code. What a test leaves behind is ended, and a test that takes too long."""
        RUNNING.add(process.pid)
        try:
            return process.wait(TIME_MAX_COMPUTING if self.of == "computing" else TIME_MAX)
        except subprocess.TimeoutExpired:
            self.end(process.pid)
            return process.wait()
        finally:
            RUNNING.discard(process.pid)
            self.end(process.pid)

    @staticmethod
    def end(group):
        """Ends a test with everything that it has started."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(group, signal.SIGKILL)


def cargo(*arguments):
    """Runs cargo; the messages that it prints for programs."""
    command = ["cargo", *arguments, "--profile", PROFILE, "--locked", "--message-format", "json-render-diagnostics"]
    done = subprocess.run(command, cwd=TOP, stdout=subprocess.PIPE, check=False)
    if done.returncode != 0:
        sys.exit(done.returncode)
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith(b"{")]


def build(packages):
    """Builds the tests of these packages, or all, with the programs that they start; the messages of cargo."""
    if not packages:
        return cargo("build", "--workspace", "--bins", "--tests")
    told = subprocess.run(["cargo", "metadata", "--format-version", "1", "--no-deps", "--locked"],
                          cwd=TOP, stdout=subprocess.PIPE, check=True)
    known = {package["name"]: package["targets"] for package in json.loads(told.stdout)["packages"]}
    if unknown := [package for package in packages if package not in known]:
        sys.exit(f"error: there is no package {unknown[0]}\n  wanted  one of {' '.join(sorted(known))}")
    messages = []
    for package in packages:
        for name in filter(known.get, [package, f"{package}-tests"]):
            targets = [target["name"] for target in known[name] if target["test"]]
            if all(target["kind"] == ["test"] for target in known[name]):
                # With the features of the whole workspace, so that nothing is built again.
                programs = ["--bins"] if WITH_PROGRAMS.intersection(targets) else []
                messages += cargo("build", "--workspace", *programs, *(word for t in targets for word in ("--test", t)))
            else:
                messages += cargo("build", "--package", name, "--tests")
    return messages


def build_zenoh():
    """Builds the tests that need zenoh, with the whole network that they start; the messages of cargo."""
    features = ",".join(f"{package}/{feature}" for package, feature in ZENOH.items())
    # In one build, so that nothing is built twice.
    words = [word for package in [*ZENOH, "ledgerctl", "ledgerd-interop"] for word in ("--package", package)]
    return cargo("build", *words, "--features", features, "--bins", "--tests")


def listed(message):
    """The tests of a binary."""
    binary, directory = message["target"]["name"], Path(message["manifest_path"]).parent
    program = message["executable"]
    told = subprocess.run([program, "--list", "--format", "terse"], cwd=directory, stdout=subprocess.PIPE, check=True)
    names = re.findall(r"^(.*): test$", told.stdout.decode(), re.M)
    variables = {"CARGO_MANIFEST_DIR": str(directory)}
    return [Test(binary, name, [program, "--exact", name, "--nocapture"], directory, variables) for name in names]


def examples():
    """The examples in the documentation of libraries, which no binary has."""
    command = ["cargo", "test", "--doc", "--workspace", "--profile", PROFILE, "--locked"]
    # With other variables than those of the build, ring and everything that uses it would be built again.
    return Test("documentation", "examples", command, TOP, {})


def interrupted(number, _frame):
    """Leaves no test behind."""
    for group in list(RUNNING):
        Test.end(group)
    os._exit(128 + number)


def main():
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupted)
    parser = argparse.ArgumentParser(prog="./test", description="Builds the tests and runs them in one pool.")
    parser.add_argument("--long", action="store_true", help="what is left out otherwise, and searches for new cases")
    parser.add_argument("--zenoh", action="store_true", help="the tests of the bridge over zenoh")
    parser.add_argument("-p", "--package", action="append", default=[], help="only a package, and the one with its tests")
    parser.add_argument("names", nargs="*", metavar="NAME", help="only tests with this in their names")
    asked = parser.parse_args()
    begun = time.monotonic()

    messages = build_zenoh() if asked.zenoh else build(asked.package)
    binaries = [message for message in messages if message.get("executable") and message["profile"]["test"]]
    print(f"test: built in {time.monotonic() - begun:.0f} s", flush=True)
    with ThreadPoolExecutor(PROCESSORS) as pool:
        tests = [test for found in pool.map(listed, binaries) for test in found]
    is_in = lambda test, prefixes: any(test.name.startswith(prefix) for prefix in prefixes)
    if asked.zenoh:
        os.environ["LEDGERD_TEST_TRANSPORT"] = "zenoh"
        if gone := [prefix for prefix in ZENOH_TESTS + NO_ZENOH if not any(is_in(test, [prefix]) for test in tests)]:
            sys.exit(f"error: tests/pool.py names tests that are not there: {' '.join(gone)}")
        tests = [test for test in tests if is_in(test, ZENOH_TESTS) and not is_in(test, NO_ZENOH)]
    elif not asked.package:
        tests.append(examples())
        there = {test.name.split("::")[0] for test in tests}
        gone = set.union(WITH_PROGRAMS, *(binaries for _, binaries in CLASSES.values())) - there
        gone |= {prefix for prefix in FIRST + LONG + LONGER + ALONE if not any(is_in(test, [prefix]) for test in tests)}
        if gone:
            sys.exit(f"error: tests/pool.py names tests that are not there: {' '.join(sorted(gone))}")
    left_out = []
    if asked.long:
        os.environ["LEDGERD_TEST_LONG"] = "1"
        tests = [test for test in tests if is_in(test, LONG + LONGER)]
    else:
        left_out = [test for test in tests if is_in(test, LONG)]
        tests = [test for test in tests if not is_in(test, LONG)]
    if asked.names:
        named = lambda test: any(name in test.name for name in asked.names)
        tests, left_out = list(filter(named, tests)), list(filter(named, left_out))

    durations = json.loads(DURATIONS.read_text()) if DURATIONS.exists() else {}
    tests.sort(key=lambda test: (-durations.get(test.name, 0.0), not is_in(test, FIRST)))
    done, lock = [], threading.Lock()

    def run(test):
        test.run()
        with lock:
            done.append(test)
            if test.failed:
                print(f"\n== {test.name} failed after {test.seconds:.0f} s\n{test.output}", flush=True)
            elif len(done) % 200 == 0:
                print(f"test: {len(done)} of {len(tests)} after {time.monotonic() - begun:.0f} s", flush=True)

    alone = [test for test in tests if is_in(test, ALONE)]
    with contextlib.ExitStack() as stack:
        pools = {of: stack.enter_context(ThreadPoolExecutor(slots)) for of, (slots, _) in CLASSES.items()}
        for test in tests:
            if test not in alone:
                pools[test.of].submit(run, test)
    for test in alone:
        run(test)
    again = [test for test in done if test.failed]
    if len(again) > AGAIN_MAX or len(tests) < FEW or any(test.of == "computing" or test in alone for test in again):
        again = []
    for test in again:
        done.remove(test)
        print(f"test: {test.name} once more, alone", flush=True)
        run(test)
    DURATIONS.write_text(json.dumps({**durations, **{test.name: round(test.seconds, 2) for test in done}}, indent=0))

    print()
    skipped = [test for test in done if test.skipped]
    for why in sorted({reason for test in skipped for reason in test.skipped}):
        print(f"skipped: {sum(why in test.skipped for test in skipped)} × {why}")
    if left_out:
        print(f"skipped: {len(left_out)} × left to ./test --long")
    for test in sorted(done, key=lambda test: -test.seconds)[:5]:
        print(f"slowest: {test.seconds:6.1f} s  {test.name}")
    failed = [test for test in done if test.failed]
    for test in again:
        if not test.failed:
            print(f"passed alone, failed beside others: {test.name}")
    for test in failed:
        print(f"failed:  {test.name}")
    print(f"test: {time.monotonic() - begun:.0f} s in all")
    passed = sum(test.passed for test in done) - len(skipped)
    print(f"{passed} passed, {sum(test.failed for test in failed)} failed, {len(skipped) + len(left_out)} skipped", flush=True)
    sys.exit(1 if failed or not done else 0)


if __name__ == "__main__":
    main()
