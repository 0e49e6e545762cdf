// Lines of two texts: those that went, and those that came.

/** @typedef {{ kind: "same" | "gone" | "new", text: string }} Line */

/**
 * By the longest common lines; texts of policies are short.
 * @param {string} before
 * @param {string} after
 * @returns {Line[]}
 */
export function diff(before, after) {
  const one = before ? before.split("\n") : [];
  const other = after ? after.split("\n") : [];
  /** @type {number[][]} */
  const common = Array.from({ length: one.length + 1 }, () => new Array(other.length + 1).fill(0));
  const at = (/** @type {number} */ i, /** @type {number} */ j) => common[i]?.[j] ?? 0;
  for (let i = one.length - 1; i >= 0; i -= 1) {
    const row = common[i] ?? [];
    for (let j = other.length - 1; j >= 0; j -= 1) row[j] = one[i] === other[j] ? at(i + 1, j + 1) + 1 : Math.max(at(i + 1, j), at(i, j + 1));
  }
  /** @type {Line[]} */
  const lines = [];
  let i = 0;
  let j = 0;
  while (i < one.length || j < other.length) {
    const [old, now] = [one[i], other[j]];
    if (old !== undefined && old === now) {
      lines.push({ kind: "same", text: old });
      i += 1;
      j += 1;
    } else if (old !== undefined && (now === undefined || at(i + 1, j) >= at(i, j + 1))) {
      lines.push({ kind: "gone", text: old });
      i += 1;
    } else {
      lines.push({ kind: "new", text: now ?? "" });
      j += 1;
    }
  }
  return lines;
}
