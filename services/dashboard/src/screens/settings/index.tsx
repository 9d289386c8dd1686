// What operators set: who may sign in, whom the farm tells of events, how long things are kept; and who did
// what.

import { useEffect } from "preact/hooks";
import { param, setQuery } from "../../state/route";
import { mayOperate, session } from "../../state/session";
import { titled } from "../../state/tab";
import { Choice } from "../../ui/parts";
import { Audit } from "./audit";
import { Kept } from "./kept";
import { Tokens } from "./tokens";
import { Webhooks } from "./webhooks";
import "../../styles/settings.css";

const PARTS = [
  ["tokens", "Tokens"],
  ["webhooks", "Webhooks"],
  ["kept", "Kept"],
  ["audit", "Audit"],
] as const;

const SHOWN = { tokens: Tokens, webhooks: Webhooks, kept: Kept, audit: Audit };

export function SettingsScreen() {
  useEffect(() => titled("Settings"), []);
  if (!mayOperate.value) {
    return (
      <div class="alone">
        <h1>Settings</h1>
        <p>
          Your role is {session.value?.role}. Tokens, webhooks, what is kept, and the audit are for operators.
        </p>
      </div>
    );
  }
  const part = PARTS.find(([name]) => name === param("part"))?.[0] ?? "tokens";
  const Part = SHOWN[part];
  return (
    <div class="settings">
      <div class="section-head">
        <h1>Settings</h1>
        <Choice
          label="Part of the settings"
          value={part}
          options={PARTS}
          choose={(name) =>
            setQuery({
              part: name === "tokens" ? null : name,
              who: null,
              action: null,
              about: null,
              entry: null,
            })
          }
        />
      </div>
      <Part />
    </div>
  );
}
