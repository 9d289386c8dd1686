// A long list of the API, asked page by page.
//
// Pages in view are asked for again when they are old. The others wait until they are in view, so that a list
// of thousands costs no more than what is seen of it.

import { useCallback, useEffect, useMemo, useRef, useState } from "preact/hooks";
import { asError } from "./resource";

/** Items of a page. The last page has fewer. */
export const PAGE = 100;

export interface Answer<T> {
  items: T[];
  next: string | null;
}

export interface Pages<T> {
  items: readonly T[];
  /** Whether the last page is there. */
  complete: boolean;
  loading: boolean;
  error: Error | null;
  /** Says which items are seen: what is missing or old there is asked for. */
  see: (first: number, last: number) => void;
  /** Asks again for what is in view, and later for the rest. */
  again: () => void;
  /** Changes items that are there, until they are asked for again. */
  change: (change: (item: T) => T) => void;
}

interface Page<T, About> {
  token: string | null;
  next: string | null;
  items: T[];
  /** What it was asked for. */
  about: About;
  old: boolean;
}

/**
 * The list that `ask` gives page by page. Another `ask` is another list. `about` is what a page is asked for
 * besides its place, and `serves` whether that will still do.
 */
export function usePages<T, About = null>(
  ask: (token: string | null, about: About) => Promise<Answer<T>>,
  about: () => About,
  serves: (about: About) => boolean = () => true,
): Pages<T> {
  const [pages, setPages] = useState<Page<T, About>[]>([]);
  const [loading, setLoading] = useState(true);
  const [error, setError] = useState<Error | null>(null);
  const latest = useRef({ pages, about, serves, seen: [0, 50] as [number, number] });
  Object.assign(latest.current, { about, serves });
  const round = useRef(0);
  const busy = useRef(false);

  const store = useCallback((next: Page<T, About>[]) => {
    latest.current.pages = next;
    setPages(next);
  }, []);

  const fill = useCallback(async () => {
    if (busy.current) return;
    const mine = round.current;
    try {
      for (;;) {
        const { pages, seen } = latest.current;
        const place = wanted(pages, seen, latest.current.serves);
        if (place === null) break;
        busy.current = true;
        setLoading(true);
        const asked = latest.current.about();
        const token = place === 0 ? null : pages[place - 1]!.next;
        const got = await ask(token, asked);
        if (mine !== round.current) return;
        const page = { token, next: got.next, items: got.items, about: asked, old: false };
        // If items came or went, the pages behind this one begin elsewhere.
        const rest = latest.current.pages.slice(place + 1);
        const follows = rest.length === 0 || rest[0]!.token === got.next;
        store([...latest.current.pages.slice(0, place), page, ...(follows ? rest : [])]);
      }
      setError(null);
    } catch (failure) {
      if (mine === round.current) setError(asError(failure));
    }
    if (mine === round.current) {
      busy.current = false;
      setLoading(false);
    }
  }, [ask]);

  const served = useRef(fill);
  useEffect(() => {
    if (served.current !== fill) {
      served.current = fill;
      round.current++;
      busy.current = false;
      store([]);
      setLoading(true);
    }
    void fill();
  }, [fill]);

  const again = useCallback(() => {
    store(latest.current.pages.map((page) => ({ ...page, old: true })));
    void fill();
  }, [fill]);
  const see = useCallback(
    (first: number, last: number) => {
      latest.current.seen = [first, last];
      void fill();
    },
    [fill],
  );
  const change = useCallback((change: (item: T) => T) => {
    const before = latest.current.pages;
    const after = before.map((page) => {
      const items = page.items.map(change);
      return items.every((item, at) => item === page.items[at]) ? page : { ...page, items };
    });
    if (after.some((page, at) => page !== before[at])) store(after);
  }, []);
  const items = useMemo(() => pages.flatMap((page) => page.items), [pages]);
  const complete = pages[pages.length - 1]?.next === null;
  return { items, complete, loading, error, see, again, change };
}

/** The first page that is to be asked for: one in view that is old, or the next one if it is in view. */
function wanted<T, About>(
  pages: Page<T, About>[],
  [first, last]: [number, number],
  serves: (about: About) => boolean,
): number | null {
  for (let place = Math.floor(first / PAGE); place * PAGE <= last; place++) {
    const page = pages[place];
    if (!page) break;
    if (page.old || !serves(page.about)) return place;
  }
  const end = pages[pages.length - 1];
  const isMissing = !end || (end.next !== null && last >= pages.length * PAGE - 10);
  return isMissing ? pages.length : null;
}
