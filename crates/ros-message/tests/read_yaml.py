"""Reads YAML from standard input, documents that end with `---`, and prints the text `data` of each in JSON on a line."""

import json
import sys

import yaml

for document in yaml.safe_load_all(sys.stdin.buffer.read().decode("utf-8")):
    if document is not None:
        print(json.dumps(document["data"]))
