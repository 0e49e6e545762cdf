"""Contexts and enrolment: the same files as those of ledgerctl."""

from __future__ import annotations

import fcntl
import os
import stat
import threading
import unittest
from pathlib import Path

import ledgerd
from ledgerd import context as contexts
from network import SERVICE, TWIST, Dev


def modes(directory: Path) -> dict[str, int]:
    """The permissions of what is in a directory, and of itself."""
    found = {path.name: stat.S_IMODE(path.stat().st_mode) for path in directory.iterdir()}
    return found | {".": stat.S_IMODE(directory.stat().st_mode)}


class Contexts(unittest.TestCase):
    network: Dev

    @classmethod
    def setUpClass(cls) -> None:
        cls.network = Dev()

    @classmethod
    def tearDownClass(cls) -> None:
        cls.network.close()

    def ctl_enrol(self, name: str, *words: str) -> None:
        told = self.network.user(Dev.ADMIN, name, "Turtlebot4")
        options = [("--node", "node"), ("--ca-fingerprint", "ca_fingerprint"), ("--secret", "secret")]
        told_words = [word for option, key in options for word in (option, told[key])]
        self.network.ctl(None, "enroll", name, *told_words, *words)

    def test_files_and_permissions_are_those_of_ledgerctl(self) -> None:
        for kind in ("ed25519", "p256"):
            self.ctl_enrol(f"theirs-{kind}", "--key", kind)
            self.network.enrol(Dev.ADMIN, f"ours-{kind}", "Turtlebot4", key=kind)
            both = [self.network.home / "contexts" / f"{whose}-{kind}" for whose in ("theirs", "ours")]
            for context in both:
                # Both learn, and note it.
                with ledgerd.connect(context.name, home=self.network.home) as robot:
                    robot.status()
                self.network.ctl(context.name, "status")
            self.assertEqual(modes(both[0]), modes(both[1]))
            for file in ("context.toml", "msps.json", "nodes.json"):
                theirs, ours = ((context / file).read_text().replace(context.name, "NAME") for context in both)
                self.assertEqual(theirs, ours, file)
        self.assertEqual(modes(self.network.home)[".lock"], 0o600)

    def test_what_one_enrols_the_other_uses(self) -> None:
        self.network.enrol(Dev.ADMIN, "Python", "Turtlebot4")
        self.assertEqual(self.network.json("Python", "whoami")["id"], "Org1/Python")
        self.network.ctl("Python", "acquire", SERVICE)
        self.network.ctl("Python", "release", SERVICE)
        self.ctl_enrol("Rust")
        with ledgerd.connect("Rust", home=self.network.home) as robot, robot.acquire(SERVICE, wait=30) as grant:
            grant.publish(TWIST)

    def test_the_selected_context_is_the_one_of_ledgerctl(self) -> None:
        self.network.enrol(Dev.ADMIN, "selected", "Turtlebot4")
        self.network.ctl(None, "context", "use", "selected")
        self.assertEqual(ledgerd.Context.load(home=self.network.home).id, "Org1/selected")
        self.assertIn("selected", contexts.names(self.network.home))
        with self.assertRaises(ledgerd.Refusal) as refused:
            ledgerd.Context.load("selectde", self.network.home)
        self.assertEqual((refused.exception.code, refused.exception.next), ("LGR-7003", 'did you mean "selected"?'))

    def test_a_key_that_others_may_read_is_refused(self) -> None:
        self.network.enrol(Dev.ADMIN, "open", "Turtlebot4")
        os.chmod(self.network.home / "contexts/open/key.pem", 0o644)
        with self.assertRaises(ledgerd.Refusal) as refused:
            ledgerd.Context.load("open", self.network.home)
        self.assertEqual(refused.exception.name, "BAD_FILE")
        self.assertIn("mode 0644", refused.exception.found)

    def test_an_enrolment_that_broke_off_goes_on_with_its_key_whoever_began_it(self) -> None:
        told = self.network.user(Dev.ADMIN, "again", "Turtlebot4")
        elsewhere = {**told, "node": "127.0.0.1:1"}
        with self.assertRaises(ledgerd.Unreachable):
            ledgerd.enrol("again", home=self.network.home, key="p256", **elsewhere)
        (begun,) = (self.network.home / "contexts").glob(".again.enrolling-*")
        key = (begun / "key.pem").read_text()
        self.assertEqual(modes(begun), {"key.pem": 0o600, "enrolment.toml": 0o600, ".": 0o700})
        with self.assertRaises(ledgerd.Invalid):
            ledgerd.enrol("again", home=self.network.home, key="ed25519", **told)
        words = ["--node", told["node"], "--ca-fingerprint", told["ca_fingerprint"], "--secret", told["secret"]]
        self.network.ctl(None, "enroll", "again", *words)
        self.assertEqual((self.network.home / "contexts/again/key.pem").read_text(), key)
        self.assertFalse(begun.exists())
        with self.assertRaises(ledgerd.Invalid) as refused:
            ledgerd.enrol("again", home=self.network.home, **told)
        self.assertEqual(refused.exception.name, "ALREADY_EXISTS")

    def test_an_enrolment_believes_the_pinned_ca_only(self) -> None:
        told = self.network.user(Dev.ADMIN, "pinned", "Turtlebot4")
        with self.assertRaises(ledgerd.Denied) as refused:
            ledgerd.enrol("pinned", home=self.network.home, **{**told, "ca_fingerprint": "00" * 32})
        self.assertEqual((refused.exception.name, refused.exception.wanted), ("UNTRUSTED", "00" * 32))
        with self.assertRaises(ledgerd.Denied) as refused:
            ledgerd.enrol("pinned", home=self.network.home, **{**told, "secret": "wrong"})
        self.assertEqual(refused.exception.name, "ENROLMENT_REFUSED")
        self.assertFalse((self.network.home / "contexts/pinned").exists())

    def test_a_change_waits_for_whoever_reads_and_a_cut_off_one_is_finished(self) -> None:
        self.network.enrol(Dev.ADMIN, "locked", "Turtlebot4")
        stored = ledgerd.Context.load("locked", self.network.home)
        with (self.network.home / ".lock").open("rb") as lock:
            fcntl.flock(lock, fcntl.LOCK_SH)
            saving = threading.Thread(target=stored.save)
            saving.start()
            saving.join(0.2)
            self.assertTrue(saving.is_alive(), "a reader holds the lock")
            fcntl.flock(lock, fcntl.LOCK_UN)
            saving.join()
        contexts_directory = self.network.home / "contexts"
        (contexts_directory / "locked").rename(contexts_directory / ".locked.old")
        self.assertIn("locked", contexts.names(self.network.home))
        self.assertEqual(ledgerd.Context.load("locked", self.network.home).id, "Org1/locked")

    def test_names_in_a_context_cannot_break_its_file(self) -> None:
        self.network.enrol(Dev.ADMIN, "quoted", "Turtlebot4")
        stored = ledgerd.Context.load("quoted", self.network.home)
        odd = ledgerd.Context(**{**vars(stored), "label": 'a "b" \\ \n \x7f \x01 é 🤖'})
        odd.save(self.network.home)
        self.assertEqual(ledgerd.Context.load("quoted", self.network.home).label, odd.label)
        self.network.ctl("quoted", "whoami")


if __name__ == "__main__":
    unittest.main()
