// Adding a node: a one-time token, and the command for the machine.

import { useState } from "preact/hooks";
import { post } from "../../api/client";
import { Dialog } from "../../ui/dialog";
import { Field, Time, Trouble } from "../../ui/parts";
import { asError } from "../../ui/resource";

export function AddNode(props: { close: () => void }) {
  const [name, setName] = useState("");
  const [made, setMade] = useState<{ token: string; expires_at: string } | null>(null);
  const [error, setError] = useState<Error | null>(null);
  const make = async (event: Event) => {
    event.preventDefault();
    try {
      setMade(await post("/v1/join-tokens", { body: { name: name.trim(), valid_hours: 24 } }));
      setError(null);
    } catch (failure) {
      setError(asError(failure));
    }
  };
  const shell = /^[A-Za-z0-9._-]+$/.test(name.trim())
    ? name.trim()
    : `'${name.trim().replaceAll("'", "'\\''")}'`;
  return (
    <Dialog title="Add a node" close={props.close}>
      {made ? (
        <>
          <p>
            On {name}, put this one-time token into a file <code>node.join</code>. It is shown only here, and
            valid until <Time at={made.expires_at} />.
          </p>
          <pre tabIndex={0}>
            <code>{made.token}</code>
          </pre>
          <p>Then start the worker there:</p>
          <pre tabIndex={0}>
            <code>{`forelight worker --server ${location.origin} --name ${shell} \\\n  --price 0.40 --join-token-file node.join --token-file node.token`}</code>
          </pre>
          <p class="note">
            It measures its speed, joins, and appears here. Start it again with the same command at any time.
          </p>
          <div class="buttons">
            <button type="button" class="primary" onClick={props.close}>
              Done
            </button>
          </div>
        </>
      ) : (
        <form onSubmit={make}>
          <Field label="Name of the machine" hint="Unique on the farm, such as rack-8.">
            {(id) => (
              <input
                id={id}
                required
                maxLength={100}
                value={name}
                onInput={(event) => setName(event.currentTarget.value)}
              />
            )}
          </Field>
          {error && <Trouble error={error} />}
          <div class="buttons">
            <button type="submit" class="primary" disabled={name.trim() === ""}>
              Make its token
            </button>
            <button type="button" onClick={props.close}>
              Leave it
            </button>
          </div>
        </form>
      )}
    </Dialog>
  );
}
