// Keys that the page listens to.

/** Whether a key is for a field, a dialog or the browser, and not for the page. */
export function isTaken(event: KeyboardEvent): boolean {
    const target = event.target as HTMLElement;
    return target.matches('input:not([type=range]), select, textarea') || Boolean(target.closest('dialog')) || event.metaKey || event.ctrlKey || event.altKey;
}
