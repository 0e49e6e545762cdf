"""cvc5 as a program that speaks SMT-LIB on standard input, by its Python package: PyPI has no other."""

import sys

import cvc5


def commands(lines):
    """The commands of a script, each as soon as it is complete."""
    text, depth, quote = "", 0, ""
    for line in lines:
        for character in line:
            if quote:
                quote = "" if character == quote else quote
            elif character in '"|':
                quote = character
            elif character == "(":
                depth += 1
            elif character == ")":
                depth -= 1
        text += line
        if depth == 0 and not quote and text.strip():
            yield text
            text = ""


def new():
    terms = cvc5.TermManager()
    solver = cvc5.Solver(terms)
    symbols = cvc5.SymbolManager(terms)
    return solver, symbols, cvc5.InputParser(solver, symbols)


def main():
    if "--version" in sys.argv:
        print(f"This is cvc5 version {cvc5.__version__}")
        return
    solver, symbols, parser = new()
    for text in commands(iter(sys.stdin.readline, "")):
        if text.strip() == "(reset)":
            # The parser would remember the logic.
            solver, symbols, parser = new()
            continue
        parser.setStringInput(cvc5.InputLanguage.SMT_LIB_2_6, text, "standard input")
        while not (command := parser.nextCommand()).isNull():
            print(command.invoke(solver, symbols), end="", flush=True)


if __name__ == "__main__":
    main()
