import { signal } from "@preact/signals";

/** The present minute, so that what depends on the time is drawn anew once a minute. */
export const now = signal(Date.now());
