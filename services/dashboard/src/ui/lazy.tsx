// A screen that is loaded when it is first shown.

import type { ComponentType, FunctionComponent } from "preact";
import { useEffect, useState } from "preact/hooks";
import { Trouble, Waiting } from "./parts";
import { asError } from "./resource";

export function lazy<P extends object>(
  what: string,
  load: () => Promise<ComponentType<P>>,
): FunctionComponent<P> {
  let loaded: ComponentType<P> | null = null;
  return function Lazy(props: P) {
    const [, setRound] = useState(0);
    const [error, setError] = useState<Error | null>(null);
    const again = () => {
      setError(null);
      load().then(
        (component) => {
          loaded = component;
          setRound((n) => n + 1);
        },
        (failure: unknown) => setError(asError(failure)),
      );
    };
    useEffect(() => {
      if (!loaded) again();
    }, []);
    if (loaded) {
      const Component = loaded;
      return <Component {...props} />;
    }
    if (error) {
      return (
        <Trouble
          error={
            new Error(
              `A part of this page could not be loaded: ${error.message}. If the service was updated, load the page anew.`,
            )
          }
          retry={again}
        />
      );
    }
    return <Waiting>Loading {what}…</Waiting>;
  };
}
