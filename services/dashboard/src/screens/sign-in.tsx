// Signing in: by the link that `forelight dashboard` prints, or by pasting a token.

import { useEffect, useState } from "preact/hooks";
import { get, Refused } from "../api/client";
import { go, route } from "../state/route";
import { ended, session, signIn } from "../state/session";
import { titled } from "../state/tab";
import { Field, Trouble, Waiting } from "../ui/parts";
import { asError, useResource } from "../ui/resource";

type Secret = { code: string } | { token: string };

export function SignIn() {
  const code = route.value.path[0] === "sign-in" ? route.value.query.get("code") : null;
  const [state, setState] = useState<{ busy: boolean; error: Error | null }>({
    busy: code !== null,
    error: null,
  });
  useEffect(() => titled("Sign in"), []);
  const ways = useResource((signal) => get("/v1/sign-in", { signal }), []);

  const enter = async (secret: Secret) => {
    setState({ busy: true, error: null });
    try {
      await signIn(secret);
      setState({ busy: false, error: null });
      if (route.peek().path[0] === "sign-in") {
        // The code is used up. It leaves the address, so that nobody shares it.
        history.replaceState(null, "", "#/tonight");
        go(["tonight"]);
        dispatchEvent(new HashChangeEvent("hashchange"));
      }
    } catch (failure) {
      setState({ busy: false, error: explained(failure, "code" in secret) });
    }
  };
  useEffect(() => {
    if (code) void enter({ code });
    else if (route.value.path[0] === "sign-in" && session.value) go(["tonight"]);
  }, [code]);

  if (state.busy && code)
    return (
      <Alone>
        <Waiting>Signing in with the link…</Waiting>
      </Alone>
    );
  return (
    <Alone>
      <h1>forelight</h1>
      <p>Sign in to the farm at {location.host}.</p>
      {ended.value && <p>{ended.value}</p>}
      {ways.data?.provider && (
        <p>
          <a class="button primary" href="/v1/sign-in/begin">
            Sign in with {ways.data.provider}
          </a>
        </p>
      )}
      <SecretForm busy={state.busy} error={state.error} enter={(secret) => void enter(secret)} />
    </Alone>
  );
}

/** A field for a token, or for the link that holds a code. */
function SecretForm(props: { busy: boolean; error: Error | null; enter: (secret: Secret) => void }) {
  const [text, setText] = useState("");
  return (
    <form
      onSubmit={(event) => {
        event.preventDefault();
        const secret = text.trim();
        const link = /[?&]code=([^&\s]+)/.exec(secret);
        props.enter(link ? { code: link[1]! } : { token: secret });
      }}
    >
      <Field
        label="Token or link"
        hint={
          <>
            On a machine that has a token, <code>forelight dashboard</code> prints a link that signs you in.
            Or paste a token of the role viewer, submitter or operator; the farm wrote the first ones into{" "}
            <code>tokens/</code> in its data folder.
          </>
        }
      >
        {(id) => (
          <input
            id={id}
            type="password"
            autocomplete="current-password"
            spellcheck={false}
            required
            autoFocus
            value={text}
            onInput={(event) => setText(event.currentTarget.value)}
          />
        )}
      </Field>
      {props.error && <Trouble error={props.error} />}
      <div class="buttons">
        <button type="submit" class="primary" disabled={props.busy || text.trim() === ""}>
          {props.busy ? "Signing in…" : "Sign in"}
        </button>
      </div>
    </form>
  );
}

function Alone(props: { children: preact.ComponentChildren }) {
  return <main class="alone sign-in">{props.children}</main>;
}

function explained(failure: unknown, byCode: boolean): Error {
  if (failure instanceof Refused && failure.status === 401) {
    return new Error(
      byCode
        ? "This code was used already, or is older than five minutes. Run `forelight dashboard` again for a new link, or paste a token."
        : "The farm does not know this token. It may be of another farm, or was withdrawn.",
    );
  }
  return asError(failure);
}
