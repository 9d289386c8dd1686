// A sign-in provider with two groups of people. Whoever comes is the person in `person`, without a password.

import { createServer } from "node:http";
import Provider from "oidc-provider";

export const people = {
  anna: { email: "anna@studio.example", groups: ["film"] },
  omar: { email: "omar@studio.example", groups: ["wranglers"] },
  zoe: { email: "zoe@studio.example", groups: ["canteen"] },
};

/** Starts the provider. `redirect` is where it may send browsers back to. */
export async function start(redirect) {
  const state = { person: "anna" };
  const server = createServer();
  await new Promise((done) => server.listen(0, "127.0.0.1", done));
  const issuer = `http://127.0.0.1:${server.address().port}`;
  const provider = new Provider(issuer, {
    clients: [
      {
        client_id: "forelight",
        client_secret: "a-secret-of-the-service",
        redirect_uris: [redirect],
        response_types: ["code"],
        grant_types: ["authorization_code"],
      },
    ],
    pkce: { required: () => true },
    scopes: ["openid", "profile", "email", "groups"],
    claims: { openid: ["sub"], email: ["email"], groups: ["groups"], profile: ["preferred_username"] },
    conformIdTokenClaims: false,
    features: { devInteractions: { enabled: false } },
    findAccount: (_, id) => ({
      accountId: id,
      claims: () => ({ sub: id, preferred_username: id, ...people[id] }),
    }),
    interactions: { url: (_, interaction) => `/interaction/${interaction.uid}` },
    cookies: { keys: ["a key of this test"] },
  });
  const answer = provider.callback();
  server.on("request", async (request, response) => {
    if (!request.url.startsWith("/interaction/")) return answer(request, response);
    try {
      const { prompt, params, session } = await provider.interactionDetails(request, response);
      const accountId = session?.accountId ?? state.person;
      if (prompt.name === "login") {
        return await provider.interactionFinished(request, response, { login: { accountId } });
      }
      const grant = new provider.Grant({ accountId, clientId: params.client_id });
      grant.addOIDCScope(params.scope);
      return await provider.interactionFinished(request, response, { consent: { grantId: await grant.save() } });
    } catch (error) {
      response.writeHead(500).end(String(error));
    }
  });
  return { issuer, state, stop: () => server.close() };
}
