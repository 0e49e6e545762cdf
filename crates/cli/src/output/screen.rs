//! The terminal: its width, and columns that fit into it.

use rustix::termios::tcgetwinsize;

/// No column is made narrower.
pub(super) const COLUMN_MIN: usize = 8;
/// Spaces between two columns.
pub(super) const GAP: usize = 2;
/// Signs behind which a cell is broken before it is broken anywhere else.
const BREAKS: [char; 4] = [' ', ',', '/', ';'];

/// The width of the terminal that results go to, in characters; none if it is no terminal.
pub(super) fn width() -> Option<usize> {
    let size = tcgetwinsize(std::io::stdout()).ok()?;
    (size.ws_col > 0).then_some(size.ws_col.into())
}

/// The widths with which columns fit into `room` characters. The widest are made narrower: first down to their longest words (`least`),
/// then further, if that is not enough.
pub(super) fn fitted(widths: Vec<usize>, least: &[usize], room: usize) -> Vec<usize> {
    narrowed(narrowed(widths, least, room), &vec![COLUMN_MIN; least.len()], room)
}

/// The width of a line with columns of these widths.
pub(super) fn whole(widths: &[usize]) -> usize {
    widths.iter().map(|width| width + GAP).sum::<usize>().saturating_sub(GAP)
}

fn narrowed(mut widths: Vec<usize>, least: &[usize], room: usize) -> Vec<usize> {
    loop {
        let excess = whole(&widths).saturating_sub(room);
        let wide = widths.iter_mut().zip(least).filter(|(width, least)| **width > **least).map(|(width, _)| width);
        let Some(widest) = wide.max().filter(|_| excess > 0) else { return widths };
        *widest -= 1;
    }
}

/// The longest part of a cell that is not broken if that can be helped.
pub(super) fn longest_word(cell: &str) -> usize {
    cell.split_inclusive(BREAKS).map(|word| word.trim_end().chars().count()).max().unwrap_or_default()
}

/// The lines of a cell within a width: broken behind words where that goes, else within them.
pub(super) fn broken(cell: &str, width: usize) -> Vec<String> {
    let mut lines = vec![String::new()];
    for word in cell.split_inclusive(BREAKS) {
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
#[expect(clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn columns_that_fit_stay_and_the_widest_give_way() {
        let fit = |widths: &[usize], room| fitted(widths.to_vec(), &[9, 9, 9][..widths.len()], room);
        assert_eq!(fit(&[10, 20], 32), [10, 20]);
        assert_eq!(fit(&[10, 20], 26), [10, 14]);
        assert_eq!(fit(&[30, 30, 4], 40), [16, 16, 4]);
        assert_eq!(fit(&[30, 30], 5), [8, 8], "a screen can be too narrow");
        assert_eq!(fitted(vec![9, 30], &[9, 10], 24), [9, 13]);
        assert_eq!(fitted(vec![20, 30], &[20, 10], 40), [20, 18], "words stay whole while that goes");
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
