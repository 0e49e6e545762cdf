// The parts of the address behind the #.

/**
 * The parts of a hash; none if it is not an address of the console, such as `#/%`.
 * @param {string} hash
 * @returns {string[]}
 */
export function partsOf(hash) {
  try {
    return hash.replace(/^#\/?/, "").split("/").filter(Boolean).map(decodeURIComponent);
  } catch {
    return [];
  }
}
