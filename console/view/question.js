// A question before an act that sets a robot in motion or takes it from its holder. It needs a reason, and is answered at another place
// and at another time than the button that asks: a double click there never answers it. The page behind it stays usable.

import { h, refresh } from "./dom.js";
import { rejected } from "./parts.js";

/**
 * @typedef {{ title: string, about: string, confirm: string, run: (reason: string) => Promise<unknown> }} Act
 */

// Longer than a double click.
const WAIT_MS = 1000;
const REASON_MAX = 200;

export class Question {
  /** @type {Act | undefined} */
  #act;
  /** @type {HTMLElement | undefined} */
  #from;
  /** @type {HTMLElement | undefined} */
  #field;
  #opened = 0;
  #isRight = true;
  #isBusy = false;
  #reason = "";
  /** @type {unknown} */
  #error;

  /**
   * The handler of a button that asks.
   * @param {Act} act
   */
  asks(act) {
    return (/** @type {MouseEvent} */ event) => {
      // The second click of a double click has taken the focus.
      if (this.#act) return this.#field?.focus();
      this.#act = act;
      this.#from = /** @type {HTMLElement} */ (event.currentTarget);
      this.#opened = Date.now();
      // The answer is on the other side. The question is at the bottom, and the button that stops is at the top.
      this.#isRight = event.clientX < innerWidth / 2;
      this.#reason = "";
      this.#error = undefined;
      setTimeout(refresh, WAIT_MS);
      addEventListener("keydown", this.#key);
      refresh();
    };
  }

  /** @param {KeyboardEvent} event */
  #key = (event) => void (event.key === "Escape" && this.#close());

  #close() {
    this.end();
    this.#from?.focus();
    refresh();
  }

  /** The question is over, and so may be its page. */
  end() {
    this.#act = undefined;
    removeEventListener("keydown", this.#key);
  }

  #isReady() {
    return !this.#isBusy && this.#reason.trim() !== "" && Date.now() - this.#opened >= WAIT_MS;
  }

  async #answer() {
    const act = this.#act;
    if (!act || !this.#isReady()) return;
    this.#isBusy = true;
    refresh();
    try {
      await act.run(this.#reason.trim());
      this.#close();
    } catch (error) {
      this.#error = error;
    }
    this.#isBusy = false;
    refresh();
  }

  show() {
    const act = this.#act;
    if (!act) return null;
    const typed = (/** @type {any} */ event) => {
      this.#reason = event.target.value;
      // Enter answers only what is still open then.
      refresh();
    };
    const submit = (/** @type {Event} */ event) => {
      event.preventDefault();
      void this.#answer();
    };
    return h(
      `div.question.${this.#isRight ? "right" : "left"}`,
      { key: "question", role: "dialog", "aria-labelledby": "question" },
      h(
        "form",
        { onsubmit: submit },
        h("h2", { id: "question" }, act.title),
        h("p", act.about),
        h(
          "label",
          h("span", "Reason"),
          h("input", {
            name: "reason",
            value: this.#reason,
            required: true,
            maxlength: REASON_MAX,
            autocomplete: "off",
            placeholder: "why, for the others",
            oninput: typed,
            mounted: (/** @type {HTMLElement} */ field) => (this.#field = field).focus(),
          }),
        ),
        rejected(this.#error),
        h(
          "div.actions",
          h("button.plain", { type: "button", onclick: () => this.#close() }, "Cancel"),
          h("button.danger", { type: "submit", disabled: !this.#isReady(), "aria-busy": this.#isBusy }, act.confirm),
        ),
      ),
    );
  }
}
