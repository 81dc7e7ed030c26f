"""HEAD is answered wherever GET is, as uptime monitors ask: the same headers without a body (RFC 9110, 9.3.2)."""

from starlette.types import ASGIApp, Message, Receive, Scope, Send


class _HeadSentError(Exception):
    """The head of an answer is sent; its body is not asked for."""


def answering_heads(app: ASGIApp) -> ASGIApp:
    """Ask `app` for GET where a client asks for HEAD, and end the answer after its head: streams have no end."""

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http" or scope["method"] != "HEAD":
            await app(scope, receive, send)
            return

        async def send_head(message: Message) -> None:
            if message["type"] == "http.response.start":
                await send(message)
            else:
                await send({"type": "http.response.body", "body": b""})
                raise _HeadSentError

        try:
            await app({**scope, "method": "GET"}, receive, send_head)
        except* _HeadSentError:
            pass

    return answer
