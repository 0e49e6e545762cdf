#!/usr/bin/env python3
"""Draws the pictures of README.md from the running programs: docs/pictures/draw.py demo|console

`ledgerd` and `ledgerctl` are those of PATH. `demo` runs `ledgerd demo` in a terminal of its own and writes demo.svg: the screen as
text, up to the table of rates. `console` runs `ledgerd dev` with a driver and a queue and writes console.png: the page of the robot
in Chromium. It needs the packages of console/ (`npm ci`). Only the standard library of Python is used.
"""

import contextlib
import json
import os
import pty
import re
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections import Counter
from pathlib import Path
from xml.sax.saxutils import escape

HERE = Path(__file__).resolve().parent
TOP = HERE.parent.parent
SVG_BYTES_MAX, PNG_BYTES_MAX = 60_000, 150_000

# The terminal: columns at most, and the pixels of a character.
COLUMNS, WIDE, HIGH, MARGIN = 112, 7.2, 17, 16
# SGR codes of the demo, and the class of each in the picture.
CLASSES = {"1": "bold", "2": "dim", "31": "red", "32": "green", "33": "yellow", "36": "cyan"}
STYLE = (
    ".card{fill:#fbfcfd;stroke:#c5d0da}text{fill:#1b2733;font:12px ui-monospace,SFMono-Regular,Menlo,Consolas,'DejaVu Sans Mono',monospace;"
    "white-space:pre}.bold{font-weight:600}.dim{fill:#5b6b7a}.red{fill:#a12f2f}.green{fill:#2c6b3b}.yellow{fill:#7d5a00}.cyan{fill:#1c6277}.bar{fill:#4a6785}"
    "@media (prefers-color-scheme:dark){.card{fill:#161c22;stroke:#3a4854}text{fill:#e6edf3}.dim{fill:#a9b8c6}.red{fill:#ef9a9a}"
    ".green{fill:#8fd3a0}.yellow{fill:#e6c36a}.cyan{fill:#86cbe0}.bar{fill:#86a8c7}}"
)


def output(command):
    """What a command writes to a terminal."""
    process, terminal = pty.fork()
    if process == 0:
        os.environ["TERM"] = "xterm-256color"
        os.execvp(command[0], command)
    written = b""
    with contextlib.suppress(OSError):
        while part := os.read(terminal, 65536):
            written += part
    _, status = os.waitpid(process, 0)
    if status:
        sys.exit(f"{command} fails with {os.waitstatus_to_exitcode(status)}: {written.decode(errors='replace')[-2000:]}")
    return written.decode()


def screen(written):
    """The lines on the screen at the end: lists of (class, character). Knows the control sequences that the demo uses, and no other."""
    lines, row, column, style = [[]], 0, 0, ""
    for sequence, character in re.findall(r"\x1b\[([0-9;]*[A-Za-z])|([^\x1b])", written):
        count = int(sequence[:-1] or 1) if sequence[:-1].isdigit() or sequence[:-1] == "" else 1
        if sequence.endswith("m"):
            style = CLASSES.get(sequence[:-1].split(";")[-1], "")
        elif sequence.endswith("A"):
            row = max(0, row - count)
        elif sequence.endswith("J"):
            del lines[row + 1 :]
            del lines[row][column:]
        elif sequence.endswith("K"):
            del lines[row][column:]
        elif sequence:
            sys.exit(f"unknown control sequence {sequence!r}")
        elif character == "\r":
            column = 0
        elif character == "\n":
            row, column = row + 1, 0
            lines.extend([] for _ in range(row + 1 - len(lines)))
        else:
            line = lines[row]
            line.extend([("", " ")] * (column + 1 - len(line)))
            line[column] = (style, character)
            column += 1
    return lines


def wrapped(line):
    """A line as a terminal of so few columns shows it, broken between words and indented below its text."""
    indent = 9
    while len(line) > COLUMNS:
        at = max(at for at in range(COLUMNS) if line[at][1] == " ")
        yield line[:at]
        line = [("", " ")] * indent + line[at + 1 :]
    yield line


def svg(lines, title, about):
    """The lines as a picture whose text is text. Bars of full blocks are rectangles, because fonts leave gaps between blocks."""
    width = round(2 * MARGIN + WIDE * max(map(len, lines)))
    height = 2 * MARGIN + HIGH * len(lines)
    shapes = []
    for row, line in enumerate(lines):
        y = MARGIN + HIGH * (row + 1) - 4
        runs, at = [], 0
        while at < len(line):
            style, character = line[at]
            is_bar = character == "█"
            end = at
            while end < len(line) and (line[end][0], line[end][1] == "█") == (style, is_bar):
                end += 1
            text = "".join(each for _, each in line[at:end])
            x = MARGIN + WIDE * at
            if is_bar:
                shapes.append(f'<rect class="bar" x="{x:g}" y="{y - 10}" width="{WIDE * (end - at):g}" height="12"/>')
            elif text.strip():
                x += WIDE * (len(text) - len(text.lstrip()))
                named = f' class="{style}"' if style else ""
                # Columns of a table are placed each, so that they are aligned in any font.
                for part in re.finditer(r"\S+(?: \S+)*", text):
                    x = MARGIN + WIDE * (at + part.start())
                    runs.append(f'<text{named} x="{x:g}" y="{y}" textLength="{WIDE * len(part[0]):g}">{escape(part[0])}</text>')
            at = end
        shapes += runs
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" role="img" aria-labelledby="title about">\n'
        f'<title id="title">{escape(title)}</title>\n<desc id="about">{escape(about)}</desc>\n<style>{STYLE}</style>\n'
        f'<rect class="card" x=".5" y=".5" width="{width - 1}" height="{height - 1}" rx="8"/>\n' + "\n".join(shapes) + "\n</svg>\n"
    )


def demo():
    """demo.svg."""
    lines = screen(output(["ledgerd", "demo"]))
    texts = ["".join(character for _, character in line).rstrip() for line in lines]
    end = next(at for at, text in enumerate(texts) if text.lstrip().startswith("latency in ms"))
    prompt = [("dim", "$"), *(("bold", character) for character in " ledgerd demo")]
    shown = [prompt, *(part for line in lines[: end - 1] for part in wrapped(line))]
    about = "Two organisations, two users, one robot: the steps of the demo, the rates of both publishers, and the rates at the robot."
    drawn = svg(shown, "Output of ledgerd demo in a terminal", about)
    write(HERE / "demo.svg", drawn.encode(), SVG_BYTES_MAX)


def ctl(home, *arguments, context=None):
    """The JSON that ledgerctl prints."""
    command = ["ledgerctl", *(["--context", context] if context else []), "--output", "json", *arguments]
    done = subprocess.run(command, env=home, capture_output=True, text=True, check=False)
    # Exit code 5: the service is held, and the contender waits in the queue.
    if done.returncode not in (0, 5):
        sys.exit(f"{command}: {done.stderr}{done.stdout}")
    return json.loads(done.stdout.splitlines()[0]) if done.stdout.strip() else None


def console():
    """console.png: Salma drives the Turtlebot4 at 20 Hz, Farhad waits in its queue, and the owner's admin looks at its page."""
    with tempfile.TemporaryDirectory() as directory, contextlib.ExitStack() as programs:
        home = {**os.environ, "HOME": directory, "XDG_CONFIG_HOME": f"{directory}/.config"}

        def start(*command, stdout=subprocess.DEVNULL):
            process = subprocess.Popen(command, env=home, stdout=stdout, text=True)
            programs.callback(process.wait)
            programs.callback(process.terminate)
            return process

        node = start("ledgerd", "dev", "--json", "--listen", "127.0.0.1:0", stdout=subprocess.PIPE)
        facts = json.loads(node.stdout.readline())
        for user in ("Salma", "Farhad"):
            secret = ctl(home, "identity", "register", user, "--attr", "Turtlebot4", context="dev-org1-admin")["secret"]
            ctl(home, "enroll", user, "--node", facts["address"], "--ca-fingerprint", facts["ca_fingerprint"], "--secret", secret)
        ctl(home, "robot", "set", "Turtlebot4/cmd_vel", "on-conflict=queue", context="dev-org2-admin")
        ctl(home, "acquire", "Turtlebot4", "--for", "10m", context="Salma")
        ctl(home, "acquire", "Turtlebot4", context="Farhad")
        twist = "{linear: {x: 0.2}, angular: {z: 0.1}}"
        start("ledgerctl", "--context", "Salma", "publish", "Turtlebot4/cmd_vel", twist, "--count", "6000", "--rate", "20")
        link = ctl(home, "console", context="dev-org2-admin")["link"]
        shot = Path(directory) / "shot.png"
        begun = time.monotonic()
        subprocess.run(["node", TOP / "console/tests/picture.mjs", link, "Turtlebot4", shot], env=home, check=True)
        print(f"screenshot after {time.monotonic() - begun:.0f} s, {shot.stat().st_size} bytes")
        write(HERE / "console.png", with_palette(shot.read_bytes()), PNG_BYTES_MAX)


def with_palette(png):
    """A PNG of 8-bit RGB or RGBA as one with 256 colours: the most frequent ones, and of the others those that are farthest from
    them, so that small marks keep their colour. Other pixels take the nearest colour."""
    chunks, at = {}, 8
    while at < len(png):
        size, kind = struct.unpack(">I4s", png[at : at + 8])
        chunks[kind] = chunks.get(kind, b"") + png[at + 8 : at + 8 + size]
        at += 12 + size
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", chunks[b"IHDR"])
    if depth != 8 or colour not in (2, 6) or interlaced:
        sys.exit(f"a PNG of depth {depth} and colour type {colour}")
    size = 3 if colour == 2 else 4
    data, rows, above = zlib.decompress(chunks[b"IDAT"]), [], bytearray(width * size)
    for row in range(height):
        begin = row * (width * size + 1)
        above = unfiltered(data[begin], bytearray(data[begin + 1 : begin + 1 + width * size]), above, size)
        rows.append([bytes(above[x : x + 3]) for x in range(0, width * size, size)])
    frequent = Counter(pixel for row in rows for pixel in row)
    palette = [pixel for pixel, _ in frequent.most_common(192)]
    others = {pixel: min(distance(pixel, each) for each in palette) for pixel in frequent.keys() - set(palette)}
    while others and len(palette) < 256:
        palette.append(max(sorted(others), key=others.get))
        others = {pixel: min(far, distance(pixel, palette[-1])) for pixel, far in others.items() if far}
    index = {pixel: min(range(len(palette)), key=lambda at: distance(palette[at], pixel)) for pixel in frequent}
    packed = zlib.compress(b"".join(b"\0" + bytes(index[pixel] for pixel in row) for row in rows), 9)
    header = struct.pack(">IIBBBBB", width, height, 8, 3, 0, 0, 0)
    parts = [(b"IHDR", header), (b"PLTE", b"".join(palette)), (b"IDAT", packed), (b"IEND", b"")]
    return png[:8] + b"".join(struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)) for kind, body in parts)


def distance(one, other):
    """The squared distance of two colours."""
    return sum((a - b) ** 2 for a, b in zip(one, other, strict=True))


def unfiltered(kind, line, above, size):
    """A line of a PNG without its filter."""
    for at in range(len(line)):
        left, up, corner = (line[at - size] if at >= size else 0), above[at], (above[at - size] if at >= size else 0)
        if kind == 1:
            add = left
        elif kind == 2:
            add = up
        elif kind == 3:
            add = (left + up) // 2
        elif kind == 4:
            add = min((left, up, corner), key=lambda each: abs(left + up - corner - each))
        else:
            break
        line[at] = (line[at] + add) & 255
    return line


def write(path, content, bytes_max):
    """Writes a picture, unless it is too large for a page."""
    if len(content) > bytes_max:
        sys.exit(f"{path.name} has {len(content)} bytes, at most {bytes_max} are allowed")
    path.write_bytes(content)
    print(f"{path.name}: {len(content)} bytes")


if __name__ == "__main__":
    drawings = {"demo": demo, "console": console}
    if len(sys.argv) != 2 or sys.argv[1] not in drawings:
        sys.exit(__doc__)
    drawings[sys.argv[1]]()
