// An answer of the API on a screen: loads, keeps the old answer while it asks again, and says what went wrong.

import { useCallback, useEffect, useRef, useState } from "preact/hooks";

export interface Resource<T> {
  data: T | null;
  /** Why the last request failed, in words. */
  error: Error | null;
  loading: boolean;
  reload(): void;
}

/**
 * Calls `load` when `keys` change, and again on `reload`. An answer that arrives after the keys changed is
 * dropped. When `version` changes, the same is asked again. `load` may return `null` for "nothing to ask".
 */
export function useResource<T>(
  load: (signal: AbortSignal) => Promise<T> | null,
  keys: unknown[],
  version?: string | number,
): Resource<T> {
  const [state, setState] = useState<{ data: T | null; error: Error | null; loading: boolean }>({
    data: null,
    error: null,
    loading: true,
  });
  const [round, setRound] = useState(0);
  const keyText = JSON.stringify(keys);
  const shown = useRef(keyText);
  const latest = useRef(load);
  latest.current = load;
  // What is asked again while it is being asked waits for the answer: a slow service would never be heard.
  const busy = useRef(false);
  const again = useRef(false);

  useEffect(() => {
    const abort = new AbortController();
    again.current = false;
    const fresh = shown.current !== keyText;
    shown.current = keyText;
    const asked = latest.current(abort.signal);
    busy.current = asked !== null;
    if (!asked) {
      setState({ data: null, error: null, loading: false });
      return () => abort.abort();
    }
    setState((old) => ({ data: fresh ? null : old.data, error: old.error, loading: true }));
    const answered = asked.then(
      (data) => ({ data, error: null }),
      (error: unknown) => ({ error: asError(error) }),
    );
    void answered.then((answer) => {
      if (abort.signal.aborted) return;
      setState((old) => ({ data: old.data, ...answer, loading: false }));
      busy.current = false;
      if (again.current) setRound((n) => n + 1);
    });
    return () => abort.abort();
  }, [keyText, round]);

  const reload = useCallback(() => {
    if (busy.current) again.current = true;
    else setRound((n) => n + 1);
  }, []);
  const before = useRef({ keyText, version });
  useEffect(() => {
    const old = before.current;
    before.current = { keyText, version };
    if (old.keyText === keyText && old.version !== version) reload();
  }, [keyText, version]);
  return { ...state, reload };
}

export function asError(error: unknown): Error {
  return error instanceof Error ? error : new Error(String(error));
}

/** Calls `run` at most once in `ms`, at the end of that time. Stable over renders. */
export function useThrottled(run: () => void, ms: number): () => void {
  const timer = useRef<ReturnType<typeof setTimeout> | undefined>(undefined);
  const latest = useRef(run);
  latest.current = run;
  useEffect(() => () => clearTimeout(timer.current), []);
  return useCallback(() => {
    if (timer.current !== undefined) return;
    timer.current = setTimeout(() => {
      timer.current = undefined;
      latest.current();
    }, ms);
  }, [ms]);
}

/** The width of an element in CSS pixels, 0 until it is known. */
export function useWidth<E extends HTMLElement>(): [{ current: E | null }, number] {
  const element = useRef<E | null>(null);
  const [width, setWidth] = useState(0);
  useEffect(() => {
    const target = element.current;
    if (!target) return;
    const observer = new ResizeObserver((entries) => setWidth(Math.floor(entries[0]!.contentRect.width)));
    observer.observe(target);
    return () => observer.disconnect();
  }, []);
  return [element, width];
}
