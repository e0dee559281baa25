// Colours of lines that colour-blind people can tell apart (Okabe and Ito), in the order of use.

export const COLOURS = ['#2f7fb8', '#d55e00', '#009e73', '#cc79a7', '#b8950a', '#56b4e9', '#7a6fc0', '#8a5a2b'];
