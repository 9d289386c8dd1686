// The frame around the screens: head, navigation, connection, and who may see it.

import { useEffect, useErrorBoundary, useRef, useState } from "preact/hooks";
import { atRisk, farm, unwatch, watch } from "./state/farm";
import { lastHeard, link } from "./state/live";
import { now } from "./state/now";
import { href, route } from "./state/route";
import { mayOperate, recall, seesAll, session, signOut } from "./state/session";
import { clock, useKeys } from "./ui/keys";
import { failedLate } from "./ui/dialog";
import { clockTime, counted, timeZone, zoneAt } from "./ui/format";
import { lazy } from "./ui/lazy";
import { Trouble, Waiting } from "./ui/parts";
import { asError, useResource } from "./ui/resource";
import { SignIn } from "./screens/sign-in";
import { Tonight } from "./screens/tonight";

const Job = lazy("the job", () => import("./screens/job").then((module) => module.JobScreen));
const Farm = lazy("the farm", () => import("./screens/farm").then((module) => module.FarmScreen));
const Record = lazy("the record", () => import("./screens/record").then((module) => module.RecordScreen));
const Submit = lazy("the form", () => import("./screens/submit").then((module) => module.SubmitScreen));
const Settings = lazy("the settings", () =>
  import("./screens/settings").then((module) => module.SettingsScreen),
);
const Keys = lazy("the keys", () => import("./screens/keys").then((module) => module.KeysScreen));

const SCREENS = [
  ["tonight", "Tonight"],
  ["farm", "Farm"],
  ["record", "Record"],
  ["submit", "Submit"],
  ["settings", "Settings"],
] as const;

/** Screens of which everything would be refused to others. */
const isOffered = (screen: string) =>
  screen === "record" ? seesAll.value : screen === "settings" ? mayOperate.value : true;

export function App() {
  const recalled = useResource(() => recall().then(() => true), []);
  const known = session.value;
  useEffect(() => {
    if (!recalled.error) return undefined;
    const timer = setTimeout(recalled.reload, 5_000);
    return () => clearTimeout(timer);
  }, [recalled.error]);
  if (route.value.path[0] === "sign-in" || known === null) return <SignIn />;
  if (known === undefined) {
    return (
      <main class="alone">
        {recalled.error ? (
          <Trouble error={recalled.error} retry={recalled.reload} />
        ) : (
          <Waiting>Asking the service who you are…</Waiting>
        )}
      </main>
    );
  }
  return <SignedIn />;
}

function SignedIn() {
  useEffect(() => {
    watch();
    return () => {
      unwatch();
      failedLate.value = null;
    };
  }, []);
  useKeys();
  const main = useRef<HTMLElement>(null);
  const place = route.value.path.join("/");
  const first = useRef(true);
  useEffect(() => {
    // A new screen begins at its top, and a screen reader begins there too.
    if (first.current) first.current = false;
    else {
      scrollTo(0, 0);
      main.current?.focus({ preventScroll: true });
    }
  }, [place]);
  return (
    <>
      <a class="skip" href="#content" onClick={(event) => (event.preventDefault(), main.current?.focus())}>
        To the content
      </a>
      <Head />
      <main ref={main} tabIndex={-1} id="content">
        <FailedLate />
        <Guarded key={place} />
      </main>
    </>
  );
}

/** What failed after its question was closed. It stays until somebody has read it. */
function FailedLate() {
  const failed = failedLate.value;
  if (!failed) return null;
  return (
    <div class="failed-late">
      <Trouble error={new Error(`${failed.title} Failed: ${failed.error.message}`)} />
      <button type="button" class="plain" onClick={() => (failedLate.value = null)}>
        Dismiss
      </button>
    </div>
  );
}

/** A fault of one screen leaves the others. */
function Guarded() {
  const [fault, again] = useErrorBoundary((error: unknown) => reportError(error));
  if (!fault) return <Screen />;
  return (
    <Trouble
      error={new Error(`This screen has a fault and cannot be shown: ${asError(fault).message}.`)}
      retry={again}
    />
  );
}

function Screen() {
  const [screen, id] = route.value.path;
  switch (screen) {
    case "tonight":
      return <Tonight />;
    case "jobs":
      return id ? <Job id={id} key={id} /> : <Tonight />;
    case "farm":
      return <Farm />;
    case "record":
      return <Record />;
    case "submit":
      return <Submit />;
    case "settings":
      return <Settings />;
    case "keys":
      return <Keys />;
    default:
      return (
        <div class="alone">
          <h1>There is no such screen</h1>
          <p>
            The address names “{screen}”. <a href={href(["tonight"])}>To tonight</a>
          </p>
        </div>
      );
  }
}

function Head() {
  const here = route.value.path[0];
  const risks = atRisk.value;
  const [failed, setFailed] = useState<Error | null>(null);
  const leave = () => {
    setFailed(null);
    signOut().catch((error: unknown) => setFailed(asError(error)));
  };
  return (
    <header class="head">
      <a class="brand" href={href(["tonight"])} aria-label="forelight, to tonight">
        forelight
      </a>
      <nav aria-label="Screens">
        {SCREENS.filter(([name]) => isOffered(name)).map(([name, word]) => (
          <a key={name} href={href([name])} aria-current={here === name ? "page" : undefined}>
            {word}
            {name === "tonight" && risks > 0 && (
              <span class="badge" title={`${counted(risks, "promise")} at risk`}>
                <span class="unseen">, promises at risk: </span>
                {risks}
              </span>
            )}
          </a>
        ))}
      </nav>
      <div class="head-facts">
        <Connection />
        <span class="number clock" title={`Times are in your zone, ${timeZone}`}>
          {clock(now.value)} {zoneAt(now.value)}
        </span>
        <span class="role">
          <span class="role-name" title={session.value?.name}>
            {session.value?.role}{" "}
          </span>
          <button type="button" class="plain" onClick={leave}>
            Sign out
          </button>
          {failed && <Trouble error={failed} />}
        </span>
      </div>
    </header>
  );
}

function Connection() {
  const state = link.value;
  return (
    <span class={`connection ${state}`} role="status">
      <span class="glyph" aria-hidden="true">
        {state === "live" ? "●" : state === "lost" ? "⚠" : "◌"}
      </span>
      {state === "live" && "live"}
      {state === "catching-up" && (farm.value ? "catching up" : "connecting")}
      {state === "lost" && `no answer since ${clockTime(lastHeard.value)}`}
    </span>
  );
}
