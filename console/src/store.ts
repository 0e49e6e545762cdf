// A value that views follow.

import { useEffect, useState } from "preact/hooks";

export class Store<T> {
  private readonly followers = new Set<(value: T) => void>();
  constructor(private value: T) {}

  get = (): T => this.value;

  set(value: T): void {
    this.value = value;
    for (const follower of this.followers) follower(value);
  }

  follow(follower: (value: T) => void): () => void {
    this.followers.add(follower);
    return () => this.followers.delete(follower);
  }
}

export function useStore<T>(store: Store<T>): T {
  const [value, setValue] = useState(store.get());
  useEffect(() => {
    setValue(store.get());
    return store.follow((next) => setValue(next));
  }, [store]);
  return value;
}

// Asks again every so often, and whenever `again` changes, for as long as the view is shown.
export function useAnswer<T>(ask: () => Promise<T>, again: readonly unknown[], everyMs = 0): { answer?: T; error?: unknown; ask: () => void } {
  const [state, setState] = useState<{ answer?: T; error?: unknown }>({});
  const [count, setCount] = useState(0);
  useEffect(() => {
    let shown = true;
    const once = () =>
      ask().then(
        (answer) => shown && setState({ answer }),
        (error: unknown) => shown && setState((before) => ({ ...before, error })),
      );
    void once();
    const timer = everyMs ? setInterval(once, everyMs) : undefined;
    return () => {
      shown = false;
      clearInterval(timer);
    };
  }, [...again, count]);
  return { ...state, ask: () => setCount(count + 1) };
}

// The time, which moves: views that show what is left of something follow it.
export function useTick(everyMs = 500): void {
  const [, setTick] = useState(0);
  useEffect(() => {
    const timer = setInterval(() => setTick((tick) => tick + 1), everyMs);
    return () => clearInterval(timer);
  }, []);
}
