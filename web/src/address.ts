// The address bar follows the state of the page.
import { EMBEDDED } from "./share";
import { formatState, parseState, type State } from "./state";

/** Delay of the address while something keeps moving: browsers refuse more than about 100 addresses in 30 s. */
export const REST_MS = 120;

export function createAddress(state: () => State, report: (text: string) => void) {
  let timer = 0;
  let choiceAt = -Infinity;

  /** At once: a reload right after a click shows what was clicked. */
  function write(): void {
    window.clearTimeout(timer);
    const hash = `#${formatState(state())}`;
    if (hash !== location.hash) history.replaceState(null, "", hash);
  }

  function writeAtRest(): void {
    window.clearTimeout(timer);
    timer = window.setTimeout(write, REST_MS);
  }

  /** At once too, unless choices follow each other fast: a slider is dragged, or a key held. */
  function writeChoice(): void {
    const now = performance.now();
    if (now - choiceAt < REST_MS) writeAtRest();
    else write();
    choiceAt = now;
  }

  /** The address says what is shown; what is not understood is reported. */
  function read(): State {
    const problems: string[] = [];
    const found = parseState(location.hash, problems);
    if (problems.length) report(`Part of this link was ignored: ${problems.join("; ")}.`);
    return EMBEDDED ? { ...found, list: null } : found;
  }

  return { write, writeAtRest, writeChoice, read };
}
