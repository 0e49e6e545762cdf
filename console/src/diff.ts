// Lines of two texts, side by side: which went, which came.

export interface Line {
  kind: "same" | "gone" | "new";
  text: string;
}

// The longest common lines; texts of policies are short.
export function diff(before: string, after: string): Line[] {
  const one = before ? before.split("\n") : [];
  const other = after ? after.split("\n") : [];
  const common = Array.from({ length: one.length + 1 }, () => new Array<number>(other.length + 1).fill(0));
  for (let i = one.length - 1; i >= 0; i -= 1) {
    for (let j = other.length - 1; j >= 0; j -= 1) {
      common[i]![j] = one[i] === other[j] ? common[i + 1]![j + 1]! + 1 : Math.max(common[i + 1]![j]!, common[i]![j + 1]!);
    }
  }
  const lines: Line[] = [];
  let i = 0;
  let j = 0;
  while (i < one.length || j < other.length) {
    if (i < one.length && j < other.length && one[i] === other[j]) {
      lines.push({ kind: "same", text: one[i]! });
      i += 1;
      j += 1;
    } else if (i < one.length && (j >= other.length || common[i + 1]![j]! >= common[i]![j + 1]!)) {
      lines.push({ kind: "gone", text: one[i]! });
      i += 1;
    } else {
      lines.push({ kind: "new", text: other[j]! });
      j += 1;
    }
  }
  return lines;
}
