//! The terminal: its width, and columns that fit into it.

use rustix::termios::tcgetwinsize;

/// No column is made narrower.
const COLUMN_MIN: usize = 8;

/// The width of the terminal that results go to, in characters; none if it is no terminal.
pub(super) fn width() -> Option<usize> {
    let size = tcgetwinsize(std::io::stdout()).ok()?;
    (size.ws_col > 0).then_some(size.ws_col.into())
}

/// The widths with which columns fit into `room` characters: the widest are made narrower, down to a least width.
pub(super) fn fitted(mut widths: Vec<usize>, room: usize) -> Vec<usize> {
    loop {
        let whole: usize = widths.iter().map(|width| width + 2).sum();
        let excess = whole.saturating_sub(2).saturating_sub(room);
        let Some(widest) = widths.iter_mut().max().filter(|widest| excess > 0 && **widest > COLUMN_MIN) else {
            return widths;
        };
        *widest -= 1;
    }
}

/// The lines of a cell within a width: broken behind words where that goes, else within them.
pub(super) fn broken(cell: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in cell.split_inclusive([' ', ',', '/', ';']) {
        for c in std::iter::once(None).chain(word.chars().map(Some)) {
            let used = lines.last().map_or(0, |line| line.chars().count());
            // A word that fits into a line of its own begins there.
            let next = match c {
                None => used > 0 && used + word.trim_end().chars().count() > width && word.chars().count() <= width,
                Some(c) => used >= width && c != ' ',
            };
            if next {
                lines.push(String::new());
            }
            if let (Some(c), Some(line)) = (c, lines.last_mut()) {
                line.push(c);
            }
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_that_fit_stay_and_the_widest_give_way() {
        assert_eq!(fitted(vec![10, 20], 32), [10, 20]);
        assert_eq!(fitted(vec![10, 20], 26), [10, 14]);
        assert_eq!(fitted(vec![30, 30, 4], 40), [16, 16, 4]);
        assert_eq!(fitted(vec![30, 30], 5), [8, 8], "a screen can be too narrow");
    }

    #[test]
    fn a_cell_is_broken_behind_words_and_nothing_of_it_is_lost() {
        assert_eq!(broken("one two three", 8), ["one two ", "three"]);
        assert_eq!(broken("geometry_msgs/msg/Twist", 14), ["geometry_msgs/", "msg/Twist"]);
        assert_eq!(broken("0123456789abcdef", 6), ["012345", "6789ab", "cdef"]);
        assert_eq!(broken("", 6), [""]);
        for width in 1..20 {
            let text = "a bb  ccc,dddd; eeeeeeeeeeeeeee/f";
            assert_eq!(broken(text, width).concat(), text, "{width}");
        }
    }
}
